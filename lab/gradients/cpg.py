"""Central pattern generator: rhythms of the actuators as a function of the body alone."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from lab.gradients.response import LinearResponse
from warpvox.algos.policies.transformer import AttentionBlock

PERIODS = (10.0, 5.0)
"""Periods of the rhythms in control steps."""
MOVED = (0.035, 0.016)
"""Typical displacement of voxels in random bodies under a random wave of amplitude 0.4, in voxels, by period."""
WAVE = (-0.3, -1.0, -2.6)
"""Phases by which the first motion of all bodies runs ahead, in radians: of a column, of a row (counted downward), of a
vertical actuator. The best of 96 random waves for 256 random bodies on Walker-v0."""
TYPE, PLACE, FEATURES = slice(2, 6), slice(0, 2), 10
"""Columns of the type and of the place in :func:`describe_bodies`, and their number."""
DRIVEN = slice(4, 6)
"""Columns of the actuator types."""


def describe_bodies(bodies: np.ndarray) -> torch.Tensor:
    """Convert bodies to the network's inputs.

    Args:
        bodies: integers ``[n, rows, columns]``, types of cells (:class:`warpvox.Cell`).

    Returns:
        float32 ``[n, cells, 10]``: x and y in voxels about the mean over the body's voxels; the type, one-hot (rigid,
        soft, horizontal, vertical actuator); whether there is a voxel above, to the right, below and to the left. All
        are 0 for a cell without a voxel.
    """
    _, rows, columns = bodies.shape
    grids = torch.as_tensor(np.asarray(bodies, np.int64))
    types = functional.one_hot(grids, 5).float().flatten(1, 2)
    present = 1 - types[..., :1]
    y, x = torch.meshgrid(-torch.arange(rows), torch.arange(columns), indexing="ij")
    place = torch.stack([x.flatten(), y.flatten()], dim=1).float() * present
    place = (place - place.sum(1, keepdim=True) / present.sum(1, keepdim=True).clamp(min=1)) * present
    padded = functional.pad((grids > 0).float(), (1, 1, 1, 1))
    above, below = padded[:, :-2, 1:-1], padded[:, 2:, 1:-1]
    left, right = padded[:, 1:-1, :-2], padded[:, 1:-1, 2:]
    neighbours = torch.stack([above, right, below, left], dim=-1).flatten(1, 2) * present
    return torch.cat([place, types[..., 1:], neighbours], dim=-1)


def clock(time: torch.Tensor) -> torch.Tensor:
    """Compute sines, then cosines, ``[n, 4]``, of control steps ``[n, 1]``."""
    periods = torch.tensor(PERIODS, dtype=time.dtype, device=time.device)
    phase = 2 * math.pi * torch.remainder(time, periods) / periods
    return torch.cat([phase.sin(), phase.cos()], dim=1)


class CpgNetwork(nn.Module):
    """Network that computes open-loop rhythms for a body.

    The output for voxel c at time t is ``tanh(w_c0 + sum over k of w_ck clock_k(t))``, with sines and cosines of
    :data:`PERIODS`. At first the weights ``w_c`` are those of a travelling wave, the same for all bodies. Each layer
    sees how the weights so far would move the voxels (:class:`~lab.gradients.response.LinearResponse`), mixes that with
    types and places by a convolution over the grid and attention between the voxels, and changes the weights in two
    ways: of each actuator by itself, and by a motion that is wanted of the voxels, which each actuator serves as far as
    it moves them so (the transposed response).

    Args:
        rows, columns: of the grid that bodies lie in.
        width: of a voxel's token, a multiple of ``heads``.
    """

    typical: torch.Tensor

    def __init__(self, rows: int, columns: int, width: int = 64, heads: int = 4, layers: int = 3) -> None:
        super().__init__()
        self.shape = (rows, columns)
        self.cells, self.oscillations = rows * columns, len(PERIODS)
        self.response = LinearResponse(rows, columns, PERIODS)
        self.register_buffer("typical", torch.tensor(MOVED, dtype=torch.float64), persistent=False)
        swing = 4 * self.oscillations  # sine and cosine of x and y
        self.token = nn.Linear(FEATURES, width)
        self.place = nn.Parameter(torch.randn(self.cells, width) * 0.3)
        self.seen = nn.ModuleList(nn.Linear(swing, width) for _ in range(layers))
        self.local = nn.ModuleList(nn.Conv2d(width, width, 3, padding=1) for _ in range(layers))
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(2 * layers + 1))
        self.blocks = nn.ModuleList(AttentionBlock(width, heads) for _ in range(layers))
        self.wanted = nn.ModuleList(nn.Linear(width, swing) for _ in range(layers))
        self.own = nn.ModuleList(nn.Linear(width, 2 * self.oscillations) for _ in range(layers))
        self.rest = nn.Linear(width, 1)
        for last in (self.wanted, self.own, self.rest):
            for parameter in last.parameters():
                nn.init.zeros_(parameter)
        cell = torch.arange(self.cells)
        ahead = WAVE[0] * (cell % columns) + WAVE[1] * (cell // columns)
        phases = torch.stack([ahead, ahead + WAVE[2]], dim=1)
        wave = torch.zeros(self.cells, 2, 1 + 2 * self.oscillations)  # of horizontal and of vertical actuators
        wave[..., 1], wave[..., 1 + self.oscillations] = phases.cos(), phases.sin()
        self.wave = nn.Parameter(wave)

    def forward(self, bodies: torch.Tensor) -> torch.Tensor:
        """Compute weights ``[n, cells, 1 + clock]`` from bodies ``[n, cells, 10]`` (:func:`describe_bodies`)."""
        types, places = bodies[..., TYPE], bodies[..., PLACE]
        present, driven = types.sum(-1, keepdim=True), types[..., 2:].sum(-1)[:, None, :, None]
        distance = (places[:, :, None] - places[:, None]).square().sum(-1).add(1e-6).sqrt()[:, None]
        response = self.response.known(types).to(bodies) / self.typical.to(bodies)[:, None, None, None]
        reach = response.square().sum((2, 3)).add(1e-3).sqrt()[..., None]
        wave = torch.einsum("rct,ctk->rck", types[..., 2:], self.wave)
        swing = wave[..., 1:].unflatten(2, (2, -1)).permute(0, 3, 1, 2) * driven
        tokens = (self.token(bodies) + self.place) * present
        for k, block in enumerate(self.blocks):
            # What the weights so far would do
            moved = _moved(response, swing).unflatten(2, (self.cells, 2))  # [n, periods, cells, 2, 2]
            tokens = tokens + self.seen[k](moved.transpose(1, 2).flatten(2)) * present
            # Convolution and attention
            grid = (self.norms[2 * k](tokens) * present).transpose(1, 2).unflatten(2, self.shape)
            tokens = tokens + functional.silu(self.local[k](grid)).flatten(2).transpose(1, 2) * present
            tokens = block(tokens, distance, present[..., 0] > 0)
            # Changes of the weights
            scaled = self.norms[2 * k + 1](tokens)
            wanted = self.wanted[k](scaled).unflatten(2, (self.oscillations, 2, 2)).transpose(1, 2).flatten(2, 3)
            added = _driving(response, wanted) / reach
            own = self.own[k](scaled).unflatten(2, (self.oscillations, 2)).transpose(1, 2)
            swing = swing + (added + own) * driven
        middle = wave[..., :1] + self.rest(self.norms[-1](tokens))
        return torch.cat([middle, swing.permute(0, 2, 3, 1).flatten(2)], dim=-1)


def _moved(response: torch.Tensor, swing: torch.Tensor) -> torch.Tensor:
    """Compute the motion of voxels ``[n, periods, 2 * cells, 2]`` from actions ``[n, periods, cells, 2]``.

    The last axis are the factors of sine and cosine.
    """
    real, imaginary = response.unbind(2)
    quarter = torch.stack([-swing[..., 1], swing[..., 0]], dim=-1)
    return real @ swing + imaginary @ quarter


def _driving(response: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    """Apply the transpose of :func:`_moved`."""
    real, imaginary = response.mT.unbind(2)
    quarter = torch.stack([wanted[..., 1], -wanted[..., 0]], dim=-1)
    return real @ wanted + imaginary @ quarter
