"""Network of ``policy=grid``: shared weights for all voxels, and a summary of the whole body; fast on a CPU."""

import torch
from torch import nn

from warpvox.algos.policies.layout import FEATURES, MOVING, VoxelLayout


def weight(inputs: int, outputs: int, gain: float) -> nn.Parameter:
    """Create an orthogonally initialised parameter ``[inputs, outputs]``."""
    return nn.Parameter(nn.init.orthogonal_(torch.empty(inputs, outputs), gain))


class GridNetwork(nn.Module):
    """Network that encodes all voxels with shared weights and decodes actions with a summary of the body.

    ::

        e_c = (m_c M) (1 + f_c F)          voxel c: what moves, m_c, weighted by what does not (place, type, neighbours)
        s   = tanh(tanh(sum over cells of e_c P_c + rest R + b) H + h)         the body; P_c depends on the cell
        q_c = tanh(x_c Q + k_c)            voxel c: what it takes from the summary; k_c depends on the cell
        a_c = q_c (s / 4 + w)              its action

    A cell without a voxel, whose inputs are 0, adds nothing to the summary. A critic has half the width and gives a
    value from s. The products are those of a few large matrices, which is what a CPU is fast at.

    Args:
        width: of what is known of a voxel.
    """

    def __init__(self, layout: VoxelLayout, critic: bool, width: int = 16, summary: int = 64, heads: int = 16) -> None:
        super().__init__()
        width = (width + 1) // 2 if critic else width
        self.critic = critic
        self.moving = weight(MOVING, width, 1.0)
        self.fixed = weight(FEATURES - MOVING, width, 0.5)
        self.pool = nn.Linear(layout.cells * width + layout.rest, summary)
        self.hidden = nn.Linear(summary, summary if critic else heads)
        if critic:
            self.value = nn.Linear(summary, 1)
        else:
            self.query = nn.Linear(FEATURES, heads)
            self.cell = nn.Parameter(torch.randn(layout.cells, heads) * 0.7)
            self.local = nn.Parameter(torch.randn(heads) * 0.02)

    def forward(self, cells: torch.Tensor, rest: torch.Tensor) -> torch.Tensor:
        """Compute one output per cell ``[rows, cells]``, or a critic's value ``[rows]``."""
        count = cells.shape[1]
        flat = cells.reshape(-1, FEATURES)
        weights = torch.addmm(flat.new_ones(1), flat[:, MOVING:], self.fixed)
        encoded = ((flat[:, :MOVING] @ self.moving) * weights).reshape(-1, count * self.moving.shape[1])
        of_voxels, of_rest = self.pool.weight.t().split([encoded.shape[1], rest.shape[1]])
        pooled = torch.addmm(torch.addmm(self.pool.bias, rest, of_rest), encoded, of_voxels)
        summary = torch.tanh(self.hidden(torch.tanh(pooled)))
        if self.critic:
            return self.value(summary)[:, 0]
        # tanh x = 1 - 2 sigmoid(-2 x), of which the sigmoid takes a tenth of the time of torch's tanh on a CPU
        query = (flat @ (-2 * self.query.weight.t())).view(-1, *self.cell.shape)
        query = query.add_(-2 * (self.cell + self.query.bias)).sigmoid_()
        wanted = (0.25 * summary + self.local)[..., None]
        return torch.baddbmm(wanted.sum(1, keepdim=True), query, -2 * wanted)[..., 0]
