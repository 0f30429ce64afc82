"""Linear response: the motion of a body's voxels to oscillating actuators, to first order."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import nn

from warpvox import Cell, Physics

DEGREE = 64
"""Degree of the Chebyshev polynomials; the error is 1.3 % of the maximum for a period of 10 control steps."""
KEPT = 400 << 20
"""Maximum memory for cached responses, in bytes."""
KINDS = (Cell.RIGID, Cell.SOFT, Cell.H_ACT, Cell.V_ACT)
"""Voxel types in the order of the network's inputs."""


class LinearResponse(nn.Module):
    """Computes displacements of voxel centres under sinusoidal actions.

    Of a body in the air whose springs hardly turn: point masses in the corners of the grid, springs and relaxation of
    rest lengths of the preset ``evogym``, no drag. With K the matrix of the springs, over the mass, a response is
    H(K) f: forces f by which an actuator changes lengths, and a function H that all bodies share, that of one mass on
    one spring, here as a sum of Chebyshev polynomials. Voxels that are neighbours in the grid count as connected.
    Nothing in it learns. On the ground bodies move otherwise, but alike (tests/test_response.py).

    Args:
        periods: of the oscillations, in control steps.
    """

    incidence: torch.Tensor
    extension: torch.Tensor
    centre: torch.Tensor
    owners: torch.Tensor
    stiffness: torch.Tensor
    coefficients: torch.Tensor

    def __init__(self, rows: int, columns: int, periods: Sequence[float]) -> None:
        super().__init__()
        self.cells, self.periods, physics = rows * columns, len(periods), Physics()
        top = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
        corners = np.stack([top, top + 1, top + columns + 1, top + columns + 2], axis=1)
        sides = np.concatenate([corners[:, [0, 1]], corners[:, [2, 3]], corners[:, [0, 2]], corners[:, [1, 3]]])
        springs, of_sides = np.unique(sides, axis=0, return_inverse=True)
        of_sides = of_sides.reshape(4, self.cells)  # top, bottom, left, right
        diagonals = np.concatenate([corners[:, [0, 3]], corners[:, [1, 2]]])
        ends, count = np.concatenate([springs, diagonals]), len(springs)
        # owners of a spring, the cells of which it is a side or a diagonal; `cells` stands for none
        owners = np.full((len(ends), 2), self.cells)
        owners[of_sides[0], 0] = owners[of_sides[1], 1] = np.arange(self.cells)
        owners[of_sides[2], 0] = owners[of_sides[3], 1] = np.arange(self.cells)
        owners[count:, 0] = np.tile(np.arange(self.cells), 2)
        incidence = np.zeros((2, len(ends), self.cells))  # of horizontal and of vertical actuators
        for kind in (0, 1):
            for side in of_sides[2 * kind : 2 * kind + 2]:
                incidence[kind, side, np.arange(self.cells)] = 1.0
        self._keep("owners", owners)
        self._keep("incidence", incidence)
        self._keep("extension", _extension(ends, columns + 1, (rows + 1) * (columns + 1)))
        self._keep("centre", _centre(corners, (rows + 1) * (columns + 1)))
        main, structural = zip(*(physics.stiffness(kind) for kind in KINDS), strict=True)
        self._keep("stiffness", np.array([main, structural]) / physics.point_mass)
        self.sides = count
        # by Gershgorin's theorem no eigenvalue is larger: two springs along an axis, four diagonals
        self.largest = (4 * max(main) + 6 * max(structural)) / physics.point_mass
        self._keep("coefficients", np.stack([_polynomial(physics, period, self.largest) for period in periods]))
        self._known: dict[tuple[str, bytes], torch.Tensor] = {}

    def __getstate__(self) -> dict[str, Any]:
        """Leave cached responses out of copies and pickles, as they take hundreds of megabytes."""
        return self.__dict__ | {"_known": {}}

    def _keep(self, name: str, values: np.ndarray) -> None:
        self.register_buffer(name, torch.from_numpy(values), persistent=False)

    def forward(self, types: torch.Tensor) -> torch.Tensor:
        """Compute responses of bodies in float64.

        Args:
            types: ``[bodies, cells, 4]``, one of (rigid, soft, horizontal actuator, vertical actuator) is 1.

        Returns:
            ``[bodies, periods, 2, 2 * cells, cells]``, real and imaginary part: where x and y of each voxel (second to
            last axis) go, in voxels, by an action of 1 of an actuator (last axis). 0 for cells without a voxel.
        """
        types = types.double()
        stiffness = self._stiffness(types)
        driven = self.incidence[0] * types[:, None, :, 2] + self.incidence[1] * types[:, None, :, 3]
        driven = driven / driven.sum(-1, keepdim=True).clamp(min=1.0)  # the mean of the actions of all that drive it
        forces = self.extension.t() @ (stiffness[..., None] * driven)
        springs = self.extension.t() @ (stiffness[..., None] * self.extension)
        scaled = springs * (2 / self.largest) - torch.eye(springs.shape[-1]).to(springs)
        last, now = forces, scaled @ forces
        total = self._term(0, last) + self._term(1, now)
        for k in range(2, DEGREE + 1):
            last, now = now, 2 * (scaled @ now) - last
            total = total + self._term(k, now)
        present = types.sum(-1).repeat_interleave(2, dim=1)
        moved = (self.centre @ total) * present[:, None, :, None]
        return moved.unflatten(1, (self.periods, 2))

    def _term(self, k: int, power: torch.Tensor) -> torch.Tensor:
        return self.coefficients[..., k].reshape(-1, 1, 1) * power[:, None]

    def _stiffness(self, types: torch.Tensor) -> torch.Tensor:
        """Compute spring stiffness ``[bodies, springs]``; a shared side takes the stiffer voxel's."""
        of_cells = torch.stack([types @ kinds for kinds in self.stiffness], dim=-1)
        of_cells = torch.cat([of_cells, torch.zeros_like(of_cells[:, :1])], dim=1)
        of_springs = of_cells[:, self.owners].amax(2)
        return torch.cat([of_springs[:, : self.sides, 0], of_springs[:, self.sides :, 1]], dim=1)

    @torch.no_grad()
    def known(self, types: torch.Tensor) -> torch.Tensor:
        """Compute responses in float32, cached for repeated bodies."""
        bodies, where = (types.argmax(-1) + types.sum(-1)).to(torch.int8).cpu().numpy(), str(types.device)
        keys = [(where, row.tobytes()) for row in bodies]
        first = {key: row for row, key in enumerate(keys)}
        here = {key: self._known[key] for key in first if key in self._known}
        if missing := [key for key in first if key not in here]:
            found = self(types[[first[key] for key in missing]]).to(device=types.device, dtype=torch.float32)
            here.update(zip(missing, found.unbind(), strict=True))
            self._known.update(here)
            while len(self._known) > KEPT // (found[0].numel() * found.element_size()):
                self._known.pop(next(iter(self._known)))
        return torch.stack([here[key] for key in keys])


def _extension(ends: np.ndarray, columns: int, points: int) -> np.ndarray:
    """Build the matrix ``[springs, 2 * points]`` from point displacements (x, y interleaved) to spring extensions."""
    matrix, row = np.zeros((len(ends), 2 * points)), np.arange(len(ends))
    x, y = ends % columns, -(ends // columns)
    along = np.stack([x[:, 1] - x[:, 0], y[:, 1] - y[:, 0]], axis=1)
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    for axis in (0, 1):
        matrix[row, 2 * ends[:, 0] + axis] = -along[:, axis]
        matrix[row, 2 * ends[:, 1] + axis] = along[:, axis]
    return matrix


def _centre(corners: np.ndarray, points: int) -> np.ndarray:
    """Build the matrix ``[2 * cells, 2 * points]`` from point displacements to displacements of cell centres."""
    matrix, cell = np.zeros((2 * len(corners), 2 * points)), np.arange(len(corners))
    for corner in corners.T:
        for axis in (0, 1):
            matrix[2 * cell + axis, 2 * corner + axis] = 0.25
    return matrix


def _polynomial(physics: Physics, period: float, largest: float) -> np.ndarray:
    """Compute Chebyshev coefficients ``[2, DEGREE + 1]`` of H on [0, ``largest``], real and imaginary part."""
    nodes = np.cos(math.pi * (np.arange(DEGREE + 1) + 0.5) / (DEGREE + 1))
    values = _transfer(physics, period, (nodes + 1) * largest / 2)
    order = np.arange(DEGREE + 1)[:, None]
    found = 2 / (DEGREE + 1) * (np.cos(order * np.arccos(nodes)) @ values)
    found[0] /= 2
    return np.stack([found.real, found.imag])


def _transfer(physics: Physics, period: float, stiffness: np.ndarray) -> np.ndarray:
    """Compute the transfer function H: complex displacement of a mass on a spring per driving force.

    In a sub-step the rest length stays at ``l + rate (goal - l)``, l the length at its beginning. The exact motion to
    the next sub-step is a linear recursion, solved here for motions that are multiplied by z in each sub-step.
    """
    rate, root = physics.actuation_rate, np.sqrt(stiffness)
    angle, z = root * physics.dt, np.exp(2j * math.pi / (period * physics.substeps))
    reach, kick = (1 - np.cos(angle)) / stiffness, np.sin(angle) / root
    both = reach + kick**2 / (z - np.cos(angle))
    return rate * both / (z - 1 + rate * stiffness * both)
