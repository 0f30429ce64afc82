"""Voxel-wise observations for modular and transformer controllers: ``make_vec(..., obs="voxel")``.

The body lies in the upper left corner of a grid of cells, as large as the largest body of the batch. Every cell has
:data:`FEATURES`; those of empty cells and of padding are 0 but for the type, which is "empty". After the grid come the
task's own observations without c, the shape of the body, which the grid holds already.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from warpvox.envs.about import NUMBER, About
from warpvox.envs.snapshot import Snapshot
from warpvox.envs.spec import Observation
from warpvox.envs.terms.observations import shape
from warpvox.simulation import Simulation
from warpvox.types import ACTUATORS, ROBOT_CELLS
from warpvox.world import WorldObject

FEATURES = {"positions": slice(0, 8), "velocities": slice(8, 16), "type": slice(16, 21), "neighbours": slice(21, 25)}
"""Columns of a cell's features.

``positions``: x and y of the corners (top left, top right, bottom right, bottom left, as the body was designed) about
the robot's centre of mass; ``velocities``: of the same corners, absolute; ``type``: one of (empty, rigid, soft,
horizontal actuator, vertical actuator) is 1; ``neighbours``: 1 where the cell is connected (above, right, below, left).
"""
NUM_FEATURES = 25


@dataclass(frozen=True)
class VoxelLayout:
    """Columns of one robot's voxels in observations and actions.

    Attributes:
        rows, columns: of the grid.
        place: where the grid lies in a row of observations.
        action_cell: long ``[num_envs, num_actions]``: the cell (row-major) whose actuator an action drives; -1 for
            actions that the environment has not, or that drive another robot.
    """

    rows: int
    columns: int
    place: slice
    action_cell: torch.Tensor

    def cells(self, obs: torch.Tensor) -> torch.Tensor:
        """Extract the features of every cell, row by row from the top left: ``[..., rows * columns, 25]``."""
        return torch.unflatten(obs[..., self.place], -1, (self.rows * self.columns, NUM_FEATURES))

    def actions(self, values: torch.Tensor) -> torch.Tensor:
        """Select actions ``[num_envs, num_actions]`` from one value per cell ``[num_envs, rows * columns]``.

        Actions of other robots are 0, so that the results for all robots of a world can be added.
        """
        return values.gather(1, self.action_cell.clamp(min=0)).masked_fill(self.action_cell < 0, 0.0)


class VoxelGrid:
    """Observation term with the features of every cell in the grid around one robot."""

    __name__ = "voxels"

    def __init__(self, sim: Simulation, name: str) -> None:
        grids = [world.objects[name].grid for world in sim.worlds]
        least = sim.grid or (0, 0)
        self.rows = max(least[0], *(grid.shape[0] for grid in grids))
        self.columns = max(least[1], *(grid.shape[1] for grid in grids))
        count = self.rows * self.columns
        self.about = About("voxels of {name}: corners, velocities, type, neighbours", NUMBER, count * NUM_FEATURES)
        self._sim = sim
        self._name = name
        self._cells: dict[int, _Cells] = {}
        self._tables = self._make_tables()
        self.action_cell, self._corners, self._known, self._filled = self._tables

    def refresh(self) -> None:
        """Update the tables after the simulation's bodies changed."""
        for table, new in zip(self._tables, self._make_tables(), strict=True):
            table.copy_(new)  # in place: a captured step may read it

    def _make_tables(self) -> tuple[torch.Tensor, ...]:
        """Build index tables: each environment's cells of actions, points of cells, and fixed features.

        The last result is 1 where a cell is not empty.
        """
        # Bodies that stay keep their entries: going through a body cell by cell is slow.
        sim = self._sim
        found: list[_Cells] = []
        for design, world in enumerate(sim.worlds):
            source = world.objects[self._name]
            found.append(self._cells.get(id(source)) or self._cells_of(source, design))
        self._cells = {id(body.source): body for body in found}

        # For each design the cell that each action drives
        actions = np.full((len(found), sim.num_actions), -1, np.int64)
        for row, body, columns in zip(actions, found, sim.action_columns, strict=True):
            first = columns[self._name].start
            row[first : first + len(body.driving)] = body.driving

        # As tensors of all environments
        index = sim.design_index.cpu()
        action_cell = torch.as_tensor(actions)[index].to(sim.device)
        corners = np.stack([body.corners for body in found])
        corners = torch.as_tensor(corners)[index].flatten(1).to(sim.device)  # [num_envs, cells * 4]
        known = np.stack([body.known for body in found])
        known = torch.as_tensor(known)[index].to(sim.device, sim.dtype)
        filled = (known[..., :1] == 0).to(sim.dtype)
        return action_cell, corners, known, filled

    def _cells_of(self, source: WorldObject, design: int) -> _Cells:
        """List the cells of a body on the grid: points, type, neighbours, and actuated cells."""
        # Corners
        rows, columns = np.nonzero(source.grid)
        cells = rows * self.columns + columns
        corners = np.zeros((self.rows * self.columns, 4), np.int64)
        corners[cells] = self._sim.voxel_corners(self._name, design)

        # Whether a cell is connected with its neighbour above, right, below, left
        above, right, below, left = range(4)
        linked = np.zeros((*source.grid.shape, 4), bool)
        for first, second in source.connections.tolist():
            row, column = divmod(first, source.width)
            other_row, other_column = divmod(second, source.width)
            is_below = other_row > row
            linked[row, column, below if is_below else right] = True
            linked[other_row, other_column, above if is_below else left] = True

        # Type and neighbours
        known = np.zeros((self.rows * self.columns, NUM_FEATURES - FEATURES["type"].start))
        padded = np.zeros((self.rows, self.columns), np.int64)
        padded[: source.grid.shape[0], : source.grid.shape[1]] = source.grid
        known[:, : len(ROBOT_CELLS)] = padded.reshape(-1, 1) == np.array(ROBOT_CELLS)
        known[cells, len(ROBOT_CELLS) :] = linked[rows, columns]
        driving = np.isin(source.grid[rows, columns], ACTUATORS)
        return _Cells(source, corners, known, cells[driving])

    def __call__(self, state: Snapshot, name: str) -> torch.Tensor:
        """Compute the features of all cells of the robot ``name``, ``[num_envs, cells * 25]``."""
        places = state.relative_positions(name).transpose(1, 2)
        at = self._corners[..., None].expand(-1, -1, 2)
        parts: list[torch.Tensor] = []
        for points in (places, state.velocities(name)):
            corners = torch.unflatten(points.gather(1, at), 1, (-1, 4))
            parts.append(corners.flatten(2) * self._filled)
        return torch.cat([*parts, self._known], dim=2).flatten(1)


class _Cells(NamedTuple):
    """The cells of a body on the grid: points, features that never change (``known``), and actuated cells."""

    source: WorldObject
    corners: np.ndarray
    known: np.ndarray
    driving: np.ndarray


def voxel_observations(
    terms: tuple[Observation, ...], robots: tuple[str, ...], sim: Simulation
) -> tuple[Observation, ...]:
    """Replace the robots' shape observations of a task by a voxel grid for each robot."""
    grids = tuple(Observation(VoxelGrid(sim, name), (("name", name),)) for name in robots)
    shapes = [Observation(shape, (("name", name),)) for name in robots]
    return grids + tuple(term for term in terms if term not in shapes)


def voxel_layouts(terms: tuple[Observation, ...], places: dict[str, slice]) -> dict[str, VoxelLayout]:
    """Return the voxel layout of each robot by name; ``places`` has the columns of each term."""
    return {
        dict(term.params)["name"]: VoxelLayout(grid.rows, grid.columns, places[term.name], grid.action_cell)
        for term in terms
        if isinstance(grid := term.function, VoxelGrid)
    }
