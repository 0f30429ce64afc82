"""Network of ``policy=transformer``: attention between the voxels of a body."""

import torch
from torch import nn
from torch.nn import functional

from warpvox.algos.policies.layout import FEATURES, INPUTS, VoxelLayout
from warpvox.errors import ConfigError


class TransformerNetwork(nn.Module):
    """Transformer with one token per voxel; other observations are added after attention.

    Attention falls with the distance of two voxels' centres, as fast as each head learns. Cells without a voxel are
    not attended to. A critic takes the mean over the voxels.

    Args:
        width: of a token, a multiple of ``heads``.
        layers: blocks of attention and a network of ``2 * width`` units.
    """

    def __init__(self, layout: VoxelLayout, critic: bool, width: int = 64, heads: int = 2, layers: int = 1) -> None:
        super().__init__()
        if width % heads:
            raise ConfigError(f"The width of a transformer must be a multiple of its heads ({heads}), got {width}.")
        self.critic = critic
        self.token = nn.Linear(FEATURES, width)
        self.place = nn.Parameter(torch.randn(layout.cells, width) * 0.02)
        self.blocks = nn.ModuleList([AttentionBlock(width, heads) for _ in range(layers)])
        self.join = nn.Linear(width + layout.rest, width)
        self.out = nn.Linear(width, 1)
        nn.init.orthogonal_(self.out.weight, 1.0 if critic else 0.05)
        nn.init.zeros_(self.out.bias)

    def forward(self, cells: torch.Tensor, rest: torch.Tensor) -> torch.Tensor:
        """Compute one output per cell ``[rows, cells]``, or a critic's value ``[rows]``."""
        present = cells[..., INPUTS["type"]].sum(-1) > 0
        places = cells[..., INPUTS["place"]]
        distance = (places[:, :, None] - places[:, None]).square().sum(-1).add(1e-6).sqrt()[:, None]
        tokens = self.token(cells) + self.place
        for block in self.blocks:
            tokens = block(tokens, distance, present)
        if self.critic:
            share = present.to(tokens.dtype)[..., None]
            tokens = (tokens * share).sum(1) / share.sum(1).clamp(min=1)
            return self.out(torch.tanh(self.join(torch.cat([tokens, rest], dim=-1))))[..., 0]
        joined = torch.cat([tokens, rest[:, None].expand(-1, tokens.shape[1], -1)], dim=-1)
        return self.out(torch.tanh(self.join(joined)))[..., 0]


class AttentionBlock(nn.Module):
    """Self-attention and a small network, each with normalised inputs and a residual connection."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.before = nn.LayerNorm(width)
        self.between = nn.LayerNorm(width)
        self.query_key_value = nn.Linear(width, 3 * width)
        self.mix = nn.Linear(width, width)
        self.slope = nn.Parameter(torch.linspace(-3.0, 0.0, heads))
        self.inner = nn.Linear(width, 2 * width)
        self.outer = nn.Linear(2 * width, width)

    def forward(self, tokens: torch.Tensor, distance: torch.Tensor, present: torch.Tensor) -> torch.Tensor:
        """Update tokens ``[rows, cells, width]`` by attention over ``present`` cells, biased by ``distance``."""
        rows, count, width = tokens.shape
        # a finite bias: a body without voxels, as in a probe of zeros, must not give NaN
        bias = -functional.softplus(self.slope)[:, None, None] * distance
        bias = bias.masked_fill(~present[:, None, None], -1e9)
        parts = self.query_key_value(self.before(tokens)).view(rows, count, 3, self.heads, width // self.heads)
        query, key, value = parts.permute(2, 0, 3, 1, 4).unbind(0)
        mixed = functional.scaled_dot_product_attention(query, key, value, attn_mask=bias)
        tokens = tokens + self.mix(mixed.transpose(1, 2).reshape(rows, count, width))
        return tokens + self.outer(functional.gelu(self.inner(self.between(tokens))))
