"""``policy=cpg``: a central pattern generator: rhythms of the actuators, which follow from the body alone."""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

from warpvox.algos.policies.grid import GridNetwork
from warpvox.algos.policies.layout import FEATURES, INPUTS, MOVING, VoxelLayout
from warpvox.algos.policies.transformer import AttentionBlock
from warpvox.errors import ConfigError

__all__ = ["CpgNetwork"]

WAVE = (-0.3, -1.0, -2.6)
"""Phases by which the first motion of all bodies runs ahead, in radians: of a column, of a row (counted downward), of a
vertical actuator. The best of 96 random waves for 256 random bodies on Walker-v0."""


class CpgNetwork(nn.Module):
    """Motion without feedback: what moves does not matter, only the body and the time.

    The action of voxel c at time t is ``tanh(w_c0 + sum over k of w_ck clock_k(t))``, with sines and cosines of
    :attr:`periods`. The weights ``w_c`` are made by convolutions over the grid and attention between the voxels, from
    their places, types and connections. At first all bodies move in the same travelling wave. A critic is a
    :class:`GridNetwork`.

    Args:
        layout: sizes; of observations with the time.
        critic: whether there is one value for the body instead of one for each cell.
        width: of a voxel's token, a multiple of ``heads``.
        heads: of attention.
        layers: each a convolution over 3 x 3 cells, and a block of attention.

    Raises:
        ConfigError: ``width`` is not a multiple of ``heads``, or observations without the time.
    """

    periods = (10.0, 5.0)
    """Of the clock, in control steps."""

    def __init__(self, layout: VoxelLayout, critic: bool, width: int = 64, heads: int = 4, layers: int = 3) -> None:
        super().__init__()
        if not layout.timed:
            raise ConfigError("policy=cpg moves by the time, which is not observed: it needs obs=timed.")
        if width % heads:
            raise ConfigError(f"The width of policy=cpg must be a multiple of its heads ({heads}), got {width}.")
        self.shape, self.clock = (layout.rows, layout.columns), 2 * len(layout.periods)
        self.value = GridNetwork(layout, critic) if critic else None
        self._known: tuple[torch.Tensor, torch.Tensor] | None = None
        if critic:
            return
        self.token = nn.Linear(FEATURES - MOVING, width)
        self.place = nn.Parameter(torch.randn(layout.cells, width) * 0.3)
        self.local = nn.ModuleList(nn.Conv2d(width, width, 3, padding=1) for _ in range(layers))
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(layers + 1))
        self.blocks = nn.ModuleList(AttentionBlock(width, heads) for _ in range(layers))
        self.out = nn.Linear(width, 1 + self.clock)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)
        cell = torch.arange(layout.cells)
        ahead = WAVE[0] * (cell % layout.columns) + WAVE[1] * (cell // layout.columns)
        phases = torch.stack([ahead, ahead + WAVE[2]], dim=1)
        wave = torch.zeros(layout.cells, 2, 1 + self.clock)  # of horizontal and of vertical actuators
        wave[..., 1], wave[..., 1 + len(layout.periods)] = phases.cos(), phases.sin()
        self.wave = nn.Parameter(wave)

    def forward(self, cells: torch.Tensor, rest: torch.Tensor) -> torch.Tensor:
        """Inputs ``[rows, cells, 26]`` and ``[rows, k]`` to ``[rows, cells]``, or ``[rows]`` of a critic."""
        if self.value is not None:
            return self.value(cells, rest)
        return self.motion(self._weights_once(cells), rest[:, -self.clock :])

    def train(self, mode: bool = True) -> CpgNetwork:
        """See ``torch.nn.Module``."""
        self._known = None
        return super().train(mode)

    def _weights_once(self, cells: torch.Tensor) -> torch.Tensor:
        """:meth:`weights`; those of the last call, while nothing learns and the bodies are the same."""
        if self.training or torch.is_grad_enabled() or torch.compiler.is_exporting() or torch.jit.is_tracing():
            return self.weights(cells)
        bodies = cells[..., MOVING:]
        if self._known is None or not torch.equal(self._known[0], bodies):
            self._known = bodies.clone(), self.weights(cells)
        return self._known[1]

    def weights(self, cells: torch.Tensor) -> torch.Tensor:
        """``[rows, cells, 1 + clock]`` of inputs ``[rows, cells, 26]``."""
        types, places = cells[..., INPUTS["type"]], cells[..., INPUTS["place"]]
        present = types.sum(-1, keepdim=True)
        distance = (places[:, :, None] - places[:, None]).square().sum(-1).add(1e-6).sqrt()[:, None]
        tokens = (self.token(cells[..., MOVING:]) + self.place) * present
        for norm, local, block in zip(self.norms, self.local, self.blocks, strict=False):
            grid = (norm(tokens) * present).transpose(1, 2).unflatten(2, self.shape)
            tokens = tokens + functional.silu(local(grid)).flatten(2).transpose(1, 2) * present
            tokens = block(tokens, distance, present[..., 0] > 0)
        return self.out(self.norms[-1](tokens)) + torch.einsum("rct,ctk->rck", types[..., 2:], self.wave)

    @staticmethod
    def motion(weights: torch.Tensor, clock: torch.Tensor) -> torch.Tensor:
        """Actions ``[rows, n]`` in [-1, 1] of weights ``[rows, n, 1 + clock]`` and a clock, ``[rows or 1, clock]``."""
        return torch.tanh(weights[..., 0] + (weights[..., 1:] * clock[:, None]).sum(-1))
