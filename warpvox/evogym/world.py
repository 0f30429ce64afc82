"""Worlds made of cells or read from world files, under the names of EvoGym's module ``evogym.world``.

Here rows count upward, as in the release: row 0 of ``grid`` is the lowest. Arrays that users give and get
(``structure``) have row 0 on top.
"""

from __future__ import annotations

import errno
import functools
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np

from warpvox import world as core
from warpvox.errors import WorldError, did_you_mean, listing
from warpvox.evogym.utils import *  # noqa: F403  # as in the release, scripts may take them from here
from warpvox.evogym.utils import Pair
from warpvox.io.world_files import read_object

__all__ = ["EvoWorld", "WorldObject"]


class EvoWorld:
    """Named objects on a grid of cells that grows when objects are added.

    Attributes:
        grid: int ``[height, width]``, row 0 at the bottom.
        grid_size: :class:`Pair`, width and height.
        objects: ``{name: WorldObject}``.
    """

    def __init__(self) -> None:
        self.grid = np.zeros((1, 1), int)
        self.objects: dict[str, WorldObject] = {}

    @property
    def grid_size(self) -> Pair:
        """Width and height of the grid in cells."""
        return Pair(self.grid.shape[1], self.grid.shape[0])

    @classmethod
    def from_json(cls, file_path: str) -> EvoWorld:
        """Read a world from a file of EvoGym's design tool; errors as of :meth:`add_from_json`."""
        world = cls()
        world.add_from_json(file_path)
        return world

    def add_from_json(self, file_path: str) -> None:
        """Add all objects in a file of EvoGym's design tool.

        FileNotFoundError: no such file. WorldError (a ValueError): it is not a world, or an object cannot be added.
        """
        for obj in _read(file_path):
            self.add_object(obj)

    def add_from_array(
        self, name: str, structure: np.ndarray, x: int, y: int, connections: np.ndarray | None = None
    ) -> None:
        """Add an object made of cells ``[rows, columns]``.

        Args:
            name: unique in the world.
            structure: cells ``[rows, columns]``, row 0 on top (see ``VOXEL_TYPES``).
            x, y: cell of its lower left corner.
            connections: ``[2, k]`` pairs of flat indices into ``structure``; None connects all neighbours.

        Raises:
            WorldError: cells, connections, position or name that are not valid, or an overlap.
        """
        obj = WorldObject.from_array(name, structure, connections)
        obj.set_pos(x, y)
        self.add_object(obj)

    def add_object(self, obj: WorldObject) -> None:
        """Add an object at its position; WorldError: name or cells are taken, or the world is too large."""
        if obj.name in self.objects:
            raise WorldError(f"The world has an object named '{obj.name}' already; names must differ.")
        x, y = obj.get_pos()
        columns, rows = obj.grid.shape[::-1]
        filled = np.argwhere(self.grid[y : y + rows, x : x + columns]).tolist()
        if filled:
            cell = (x + filled[0][1], y + filled[0][0])
            raise WorldError(
                f"The object '{obj.name}' at {obj.pos} overlaps another one at cell {cell}; its bounding box must lie"
                " on empty cells."
            )
        height, width = np.maximum(self.grid.shape, (y + rows, x + columns)).tolist()
        core.check_size(width, height, f" with '{obj.name}'")
        if self.grid.shape != (height, width):
            smaller = self.grid
            self.grid = np.zeros((height, width), smaller.dtype)
            self.grid[: smaller.shape[0], : smaller.shape[1]] = smaller
        self.grid[y : y + rows, x : x + columns] = obj.grid
        self.objects[obj.name] = obj

    def remove_object(self, obj_name: str) -> WorldObject:
        """Remove an object and return a copy of it; the grid keeps its size. WorldError: no such object."""
        obj = self._find(obj_name).copy()
        x, y = obj.get_pos()
        columns, rows = obj.grid.shape[::-1]
        self.grid[y : y + rows, x : x + columns][obj.grid != 0] = 0
        del self.objects[obj_name]
        return obj

    def translate_object(self, obj_name: str, dx: int, dy: int) -> None:
        """Shift an object by some cells; errors as of :meth:`move_object`."""
        pos = self._find(obj_name).pos + Pair(dx, dy)
        self.move_object(obj_name, pos.x, pos.y)

    def move_object(self, obj_name: str, x: int, y: int) -> None:
        """Move an object's lower left corner to cell (x, y).

        WorldError: no such object, a negative position, or one where it cannot be added; it then stays where it was.
        """
        moved = self._find(obj_name).copy()
        moved.set_pos(x, y)
        before = self.objects.copy(), self.grid.copy()
        self.remove_object(obj_name)
        try:
            self.add_object(moved)
        except WorldError:
            self.objects, self.grid = before
            raise

    def pretty_print(self, voxels_per_line: int = 50) -> None:
        """Print the world in letters (R, S, H, V, F; a dot for empty), ``voxels_per_line`` columns at a time."""
        for begin in range(0, self.grid_size.x, voxels_per_line):
            block = self.grid[:, begin : begin + voxels_per_line]
            for y in reversed(range(len(block))):
                print(f"{y % 10} | " + " ".join(".RSHVF"[cell] for cell in block[y]))
            columns = range(begin, begin + block.shape[1])
            print("   -" + "--" * len(columns))
            print("    " + " ".join(str(x % 10) for x in columns) + "\n")

    def _find(self, name: str) -> WorldObject:
        if name not in self.objects:
            hint = did_you_mean(name, self.objects)
            raise WorldError(f"The world has no object named '{name}'.{hint} It has {listing(self.objects)}.")
        return self.objects[name]


class WorldObject:
    """A named group of cells with a position.

    Attributes:
        name: unique in its world.
        pos: :class:`Pair`, cell of the lower left corner.
        grid: ``[rows, columns]``, row 0 at the bottom; int, or of the type of the array that it was made of.
        grid_size: :class:`Pair`, columns and rows.
        voxels: a Pair (column, row) for every cell that is not empty.
        neighbors: for each of them the Pairs of those it is connected to.
    """

    def __init__(self) -> None:
        self.name = ""
        self.pos = Pair(0, 0)
        self.grid_size = Pair(0, 0)
        self.grid = np.zeros((0, 0), int)
        self.voxels = []
        self.neighbors = {}

    @classmethod
    def from_json(cls, file_path: str) -> WorldObject:
        """Read an object from a file; see :meth:`load_from_json`."""
        obj = cls()
        obj.load_from_json(file_path)
        return obj

    def load_from_json(self, file_path: str) -> None:
        """Replace this object by the single object in a file of EvoGym's design tool.

        Raises:
            FileNotFoundError: no such file. WorldError: it is not a world, or not of one object.
        """
        objects = _read(file_path)
        if len(objects) != 1:
            names = listing(obj.name for obj in objects)
            raise WorldError(f"The file '{file_path}' must hold one object, but holds {len(objects)}: {names}.")
        self.__dict__.clear()
        self.__dict__.update(objects[0].__dict__)

    @classmethod
    def from_array(cls, name: str, structure: np.ndarray, connections: np.ndarray | None = None) -> WorldObject:
        """Create an object at (0, 0); see :meth:`load_from_array`."""
        obj = cls()
        obj.load_from_array(name, structure, connections)
        return obj

    def load_from_array(self, name: str, structure: np.ndarray, connections: np.ndarray | None = None) -> None:
        """Replace this object by cells ``[rows, columns]`` at (0, 0), row 0 on top.

        ``connections``: ``[2, k]`` pairs of flat indices into ``structure``; None connects all neighbours.

        Raises:
            WorldError: cells or connections that are not valid.
        """
        self._replace_by(core.WorldObject.from_array(name, structure, 0, 0, connections))
        self.grid = self.grid.astype(np.asarray(structure).dtype)

    def load_from_parsed_json(self, name: str, json_data: Any, grid_size: Pair) -> None:
        """Replace this object by an entry of a parsed world file of width ``grid_size.x``.

        ``json_data`` has ``indices``, ``types`` and ``neighbors``. WorldError: they contradict each other.
        """
        cells = read_object(name, json_data, grid_size.x)
        self._replace_by(core.WorldObject.from_array(name, cells.grid, cells.x, cells.y, cells.connections))

    @classmethod
    def from_core(cls, obj: core.WorldObject) -> WorldObject:
        """Convert a :class:`warpvox.world.WorldObject` to this class."""
        made = cls()
        made._replace_by(obj)
        return made

    def _replace_by(self, obj: core.WorldObject) -> None:
        """Replace name, position and cells of this object by those of ``obj``."""
        self.name = obj.name
        self.pos = Pair(obj.x, obj.y)
        self.grid = np.flipud(obj.grid).astype(int)
        rows, columns = self.grid.shape
        self.grid_size = Pair(columns, rows)
        self._made_of = obj
        for name in ("voxels", "neighbors"):
            self.__dict__.pop(name, None)

    # Few read the two lists: most objects only go from a task into its simulation. They are made when they are read.

    @functools.cached_property
    def voxels(self) -> list[Pair]:
        """Column and row of the non-empty cells, row 0 at the bottom."""
        return _filled_cells(self._made_of)

    @functools.cached_property
    def neighbors(self) -> dict[Pair, list[Pair]]:
        """Connected cells of every non-empty cell."""
        rows, columns = self._made_of.grid.shape
        neighbors: dict[Pair, list[Pair]] = {voxel: [] for voxel in _filled_cells(self._made_of)}
        for pair in self._made_of.connections.tolist():
            a, b = (Pair(cell % columns, rows - 1 - cell // columns) for cell in pair)
            neighbors[a].append(b)
            neighbors[b].append(a)
        return neighbors

    def to_core(self) -> core.WorldObject:
        """Convert this object to a :class:`warpvox.world.WorldObject`."""
        structure = self.get_structure()
        if "neighbors" not in self.__dict__:  # nobody can have changed them
            made_of = self._made_of
            if self.name == made_of.name and np.array_equal(structure, made_of.grid):
                return made_of if self.get_pos() == (made_of.x, made_of.y) else made_of.moved(*self.get_pos())
        return core.WorldObject.from_array(self.name, structure, *self.get_pos(), self.get_connections())

    def translate(self, dx: int, dy: int) -> None:
        """Shift the object by some cells; WorldError if a coordinate becomes negative."""
        self.set_pos(self.pos.x + dx, self.pos.y + dy)

    def set_pos(self, x: int, y: int) -> None:
        """Move the object's lower left corner to cell (x, y); WorldError if a coordinate is negative."""
        pos = Pair(x, y)
        if min(pos.x, pos.y) < 0:
            raise WorldError(f"The position of '{self.name}' must not be negative, got {pos}.")
        self.pos = pos

    def get_structure(self) -> np.ndarray:
        """Return the cells ``[rows, columns]``, row 0 on top, with the dtype of ``grid``."""
        return np.flipud(self.grid)

    def get_connections(self) -> np.ndarray:
        """Return connections as pairs of flat indices, ``[2, k]``, each in both directions."""
        rows, columns = self.grid.shape
        pairs = [
            [(rows - 1 - cell.y) * columns + cell.x for cell in (voxel, near)]
            for voxel, others in self.neighbors.items()
            for near in others
        ]
        return np.array(pairs, int).reshape(-1, 2).T

    def get_pos(self) -> tuple[int, int]:
        """Return the position (x, y) of the lower left corner."""
        return self.pos.x, self.pos.y

    def rename(self, name: str) -> None:
        """Change the name."""
        self.name = name

    def get_name(self) -> str:
        """Return the name."""
        return self.name

    def copy(self) -> WorldObject:
        """Copy the object."""
        return deepcopy(self)

    __copy__ = copy

    def __str__(self) -> str:
        return f"Size {self.grid_size} object named {self.name} at {self.pos}."

    def __repr__(self) -> str:
        return f"WorldObject({self})"


def _filled_cells(obj: core.WorldObject) -> list[Pair]:
    """List column and row (0 at the bottom) of the non-empty cells, from the lowest row on."""
    return [Pair(x, y) for y, x in np.argwhere(np.flipud(obj.grid)).tolist()]


def _read(file_path: str) -> list[WorldObject]:
    if not Path(file_path).exists():
        raise FileNotFoundError(errno.ENOENT, "There is no world file", str(file_path))
    return [WorldObject.from_core(obj) for obj in core.World.from_json(Path(file_path)).objects.values()]
