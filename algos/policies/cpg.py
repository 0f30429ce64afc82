"""``policy=cpg``: a central pattern generator: rhythms of the actuators, which follow from the body alone."""

from __future__ import annotations

import torch
from torch import nn
from torch.nn import functional

from warpvox.algos.policies.grid import GridNetwork
from warpvox.algos.policies.layout import FEATURES, INPUTS, MOVING, VoxelLayout
from warpvox.algos.policies.response import LinearResponse
from warpvox.algos.policies.transformer import AttentionBlock
from warpvox.errors import ConfigError

WAVE = (-0.3, -1.0, -2.6)
"""Phases by which the first motion of all bodies runs ahead, in radians: of a column, of a row (counted downward), of a
vertical actuator. The best of 96 random waves for 256 random bodies on Walker-v0."""
LARGEST = 100
"""Cells of a grid: responses take memory with the square of their number."""
TYPE, PLACE = (slice(INPUTS[name].start - MOVING, INPUTS[name].stop - MOVING) for name in ("type", "place"))
"""Where they lie in what does not move."""


class CpgNetwork(nn.Module):
    """Motion without feedback: what moves does not matter, only the body and the time.

    The action of voxel c at time t is ``tanh(w_c0 + sum over k of w_ck clock_k(t))``, with sines and cosines of
    :attr:`periods`. At first the weights ``w_c`` are those of a travelling wave, the same for all bodies. Each layer
    sees how the weights so far would move the voxels (:class:`~warpvox.algos.policies.response.LinearResponse`), mixes
    that with types and places by a convolution over the grid and attention between the voxels, and changes the weights
    in two ways: of each actuator by itself, and by a motion that is wanted of the voxels, which each actuator serves as
    far as it moves them so (the transposed response). A critic is a :class:`GridNetwork`.

    Args:
        layout: sizes; of observations with the time.
        width: of a voxel's token, a multiple of ``heads``.
    """

    periods = (10.0, 5.0)
    """Periods of the clock, in control steps."""
    moved = (0.035, 0.016)
    """By how many voxels random bodies' voxels move in a random wave of amplitude 0.4, for each period."""
    typical: torch.Tensor

    def __init__(self, layout: VoxelLayout, critic: bool, width: int = 64, heads: int = 4, layers: int = 3) -> None:
        super().__init__()
        if not layout.timed:
            raise ConfigError("policy=cpg moves by the time, which is not observed: it needs obs=timed.")
        if layout.cells > LARGEST:
            raise ConfigError(
                f"policy=cpg computes how each voxel moves by each other one; its grid may have {LARGEST} cells,"
                f" got {layout.rows}x{layout.columns}."
            )
        if width % heads:
            raise ConfigError(f"The width of policy=cpg must be a multiple of its heads ({heads}), got {width}.")
        self.shape, self.oscillations = (layout.rows, layout.columns), len(layout.periods)
        self.value = GridNetwork(layout, critic) if critic else None
        self._known: tuple[list[tuple[int, int]], torch.Tensor, torch.Tensor] | None = None
        if critic:
            return
        self.response = LinearResponse(layout.rows, layout.columns, layout.periods)
        self.register_buffer("typical", torch.tensor(self.moved, dtype=torch.float64), persistent=False)
        swing = 4 * self.oscillations  # sine and cosine of x and y
        self.token = nn.Linear(FEATURES - MOVING, width)
        self.place = nn.Parameter(torch.randn(layout.cells, width) * 0.3)
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
        cell = torch.arange(layout.cells)
        ahead = WAVE[0] * (cell % layout.columns) + WAVE[1] * (cell // layout.columns)
        phases = torch.stack([ahead, ahead + WAVE[2]], dim=1)
        wave = torch.zeros(layout.cells, 2, 1 + 2 * self.oscillations)  # of horizontal and of vertical actuators
        wave[..., 1], wave[..., 1 + self.oscillations] = phases.cos(), phases.sin()
        self.wave = nn.Parameter(wave)

    def forward(self, cells: torch.Tensor, rest: torch.Tensor) -> torch.Tensor:
        """Inputs ``[rows, cells, 26]`` and ``[rows, k]`` to ``[rows, cells]``, or ``[rows]`` of a critic."""
        if self.value is not None:
            return self.value(cells, rest)
        return self.motion(self._weights_once(cells), rest[:, -2 * self.oscillations :])

    def train(self, mode: bool = True) -> CpgNetwork:
        self._known = None
        return super().train(mode)

    def _weights_once(self, cells: torch.Tensor) -> torch.Tensor:
        """:meth:`weights`; those of the last call, while nothing has learned and the bodies are the same."""
        bodies = cells[..., MOVING:]
        if self.training or torch.is_grad_enabled() or _becomes_a_file():
            return self.weights(bodies)
        # what was learned, by place and number of writes; those to tensors of inference mode torch does not count
        learned = [(one.data_ptr(), 0 if one.is_inference() else one._version) for one in self.parameters()]
        if self._known is None or self._known[0] != learned or not torch.equal(self._known[1], bodies):
            self._known = learned, bodies.clone(), self.weights(bodies)
        return self._known[2]

    def weights(self, bodies: torch.Tensor) -> torch.Tensor:
        """``[rows, cells, 1 + clock]`` of what does not move in the inputs, ``[rows, cells, 10]``."""
        types, places = bodies[..., TYPE], bodies[..., PLACE]
        present, driven = types.sum(-1, keepdim=True), types[..., 2:].sum(-1)[:, None, :, None]
        distance = (places[:, :, None] - places[:, None]).square().sum(-1).add(1e-6).sqrt()[:, None]
        response = (self.response(types) if _becomes_a_file() else self.response.known(types)).to(bodies)
        response = response / self.typical.to(response)[:, None, None, None]
        reach = response.square().sum((2, 3)).add(1e-3).sqrt()[..., None]
        wave = torch.einsum("rct,ctk->rck", types[..., 2:], self.wave)
        swing = wave[..., 1:].unflatten(2, (2, -1)).permute(0, 3, 1, 2) * driven
        tokens = (self.token(bodies) + self.place) * present
        for k, block in enumerate(self.blocks):
            moved = _moved(response, swing).unflatten(2, (present.shape[1], 2))  # [rows, periods, cells, 2, 2]
            tokens = tokens + self.seen[k](moved.transpose(1, 2).flatten(2)) * present
            grid = (self.norms[2 * k](tokens) * present).transpose(1, 2).unflatten(2, self.shape)
            tokens = tokens + functional.silu(self.local[k](grid)).flatten(2).transpose(1, 2) * present
            tokens = block(tokens, distance, present[..., 0] > 0)
            scaled = self.norms[2 * k + 1](tokens)
            wanted = self.wanted[k](scaled).unflatten(2, (self.oscillations, 2, 2)).transpose(1, 2).flatten(2, 3)
            added = _driving(response, wanted) / reach
            own = self.own[k](scaled).unflatten(2, (self.oscillations, 2)).transpose(1, 2)
            swing = swing + (added + own) * driven
        middle = wave[..., :1] + self.rest(self.norms[-1](tokens))
        return torch.cat([middle, swing.permute(0, 2, 3, 1).flatten(2)], dim=-1)

    @staticmethod
    def motion(weights: torch.Tensor, clock: torch.Tensor) -> torch.Tensor:
        """Actions ``[rows, n]`` in [-1, 1] of weights ``[rows, n, 1 + clock]`` and a clock, ``[rows or 1, clock]``."""
        return torch.tanh(weights[..., 0] + (weights[..., 1:] * clock[:, None]).sum(-1))


def _becomes_a_file() -> bool:
    # torch documents is_tracing, but does not list it in __all__
    return torch.compiler.is_exporting() or torch.jit.is_tracing()  # pyright: ignore[reportPrivateImportUsage]


def _moved(response: torch.Tensor, swing: torch.Tensor) -> torch.Tensor:
    """How voxels move, ``[rows, periods, 2 * cells, 2]``, by actions ``[rows, periods, cells, 2]``.

    The last axis are the factors of sine and cosine.
    """
    real, imaginary = response.unbind(2)
    quarter = torch.stack([-swing[..., 1], swing[..., 0]], dim=-1)
    return real @ swing + imaginary @ quarter


def _driving(response: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    """The transposed of :func:`_moved`."""
    real, imaginary = response.mT.unbind(2)
    quarter = torch.stack([wanted[..., 1], -wanted[..., 0]], dim=-1)
    return real @ wanted + imaginary @ quarter
