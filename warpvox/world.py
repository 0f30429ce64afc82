"""Worlds: named objects made of cells on a grid. Reads and writes EvoGym's world files.

A world says what exists and where; :mod:`warpvox.compile` turns it into points and springs. Columns count to
the right from x = 0 and rows upward from y = 0, one cell is 0.1 long. Arrays of cells always have row 0 on
top.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warpvox.checks import check_integer, is_integer
from warpvox.design import as_grid, full_connections
from warpvox.errors import WorldError, did_you_mean, listing
from warpvox.io.reading import Missing, Unreadable, parse_json, read_text
from warpvox.io.world_files import LARGEST_GRID, read_objects
from warpvox.io.writing import check_suffix, write_text
from warpvox.palette import body_svg
from warpvox.types import ACTUATORS, EMPTY_LETTER, MATERIALS, Cell

LARGEST_FILE = 16_000_000
"""Maximum size of a world file or its text, in bytes."""


@dataclass(frozen=True, eq=False)
class WorldObject:
    """A named group of cells, immutable; make variants by :func:`dataclasses.replace` or :meth:`moved`.

    Attributes:
        name: unique in its world.
        grid: int8 ``[rows, columns]``, row 0 on top (read-only). Empty border rows and columns belong to it.
        x, y: cell of the lower left corner of ``grid``, both >= 0.
        connections: int32 ``[k, 2]`` pairs ``a < b`` of flat indices into ``grid`` (row-major from the top
            row), sorted and unique (read-only): which neighbouring cells share their corners.
    """

    name: str
    grid: np.ndarray
    x: int
    y: int
    connections: np.ndarray

    @classmethod
    def from_array(
        cls, name: str, structure: object, x: int = 0, y: int = 0, connections: object = None
    ) -> WorldObject:
        """Create an object from cells ``[rows, columns]`` (row 0 on top), lower left corner at (x, y).

        ``connections`` is ``[2, k]`` as in EvoGym: pairs of flat indices into ``structure``. None connects
        all neighbours.

        Raises:
            WorldError: bad name, cells, position or connections.
        """
        if not isinstance(name, str) or not name:
            raise WorldError(f"An object needs a name (text that is not empty), got {name!r:.80}.")
        try:
            name.encode()  # JSON's escapes allow halves of characters, which no file or page can hold
        except UnicodeEncodeError:
            raise WorldError(f"The name {name!r:.80} holds half of a character (a lone surrogate).") from None
        grid = as_grid(structure, what=f"object '{name}'", error=WorldError)
        if not grid.any():
            raise WorldError(f"The object '{name}' has no cells: all of its {grid.size} entries are empty.")
        x, y = _check_position(name, x, y)
        pairs = full_connections(grid) if connections is None else _check_pairs(name, grid, connections)
        pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
        grid.flags.writeable = False
        pairs.flags.writeable = False
        return cls(name, grid, x, y, pairs)

    @property
    def width(self) -> int:
        """Number of columns of the bounding box."""
        return self.grid.shape[1]

    @property
    def height(self) -> int:
        """Number of rows of the bounding box."""
        return self.grid.shape[0]

    @functools.cached_property
    def num_actuators(self) -> int:
        """Number of actuator cells."""
        return int(np.count_nonzero(np.isin(self.grid, ACTUATORS)))

    @property
    def is_robot(self) -> bool:
        """Whether the object has an actuator."""
        return self.num_actuators > 0

    @functools.cached_property
    def is_static(self) -> bool:
        """True if all cells are fixed, so that the object never moves."""
        return bool(np.isin(self.grid, (int(Cell.EMPTY), int(Cell.FIXED))).all())

    def moved(self, x: int, y: int) -> WorldObject:
        """Return a copy of this object with the lower left corner at (x, y)."""
        x, y = _check_position(self.name, x, y)
        return replace(self, x=x, y=y)

    def key(self) -> bytes:
        """Return bytes that identify the object: equal for equal objects only."""
        return self._key

    @functools.cached_property
    def _key(self) -> bytes:
        head = json.dumps([self.name, self.x, self.y, *self.grid.shape, len(self.connections)]).encode()
        return head + self.grid.tobytes() + self.connections.tobytes()

    def __eq__(self, other: object) -> bool:
        return self.key() == other.key() if isinstance(other, WorldObject) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.key())

    def __repr__(self) -> str:
        return f"WorldObject('{self.name}', {self.width} wide, {self.height} high, at ({self.x}, {self.y}))"


class World:
    """Objects on a grid of ``width`` x ``height`` cells; the grid grows to fit added objects.

    Overlap rule (EvoGym's): the bounding box of a new object, empties included, must not cover a cell that
    another object fills. Every method that changes the world either succeeds or leaves it as it was.
    """

    def __init__(self, width: int = 1, height: int = 1) -> None:
        self.width = check_integer("The width of a world", width, 1, error=WorldError)
        self.height = check_integer("The height of a world", height, 1, error=WorldError)
        check_size(self.width, self.height)
        self.objects: dict[str, WorldObject] = {}

    def add_object(self, obj: WorldObject) -> WorldObject:
        """Add ``obj`` and return it.

        Raises:
            WorldError: the name is taken, or the bounding box covers a filled cell of another object.
        """
        if obj.name in self.objects:
            raise WorldError(f"The world has an object '{obj.name}' already; names must differ.")
        return self._put(obj)

    def add_from_array(self, name: str, structure: object, x: int, y: int, connections: object = None) -> WorldObject:
        """Add an object from cells ``[rows, columns]`` (row 0 on top), lower left corner at cell (x, y).

        ``connections``: EvoGym's ``[2, k]`` array of flat index pairs, or None to connect all neighbours.

        Raises:
            WorldError: bad cells, name, position or connections, or an overlap.
        """
        return self.add_object(WorldObject.from_array(name, structure, x, y, connections))

    def remove_object(self, name: str) -> WorldObject:
        """Remove the object ``name`` and return it; the grid keeps its size.

        Raises:
            WorldError: there is no such object.
        """
        return self.objects.pop(self._find(name).name)

    def move_object(self, name: str, x: int, y: int) -> WorldObject:
        """Move the object ``name`` so that the lower left corner is cell (x, y); return the moved object.

        Raises:
            WorldError: unknown object, negative position or an overlap; the object then stays where it was.
        """
        return self._put(self._find(name).moved(x, y))

    def add_from_json(self, source: str | os.PathLike[str] | Mapping[str, object]) -> None:
        """Add all objects of a world file to this world; accepts path, text or parsed dictionary.

        The grid becomes as large as the file says if its objects lie within, else as large as the objects need: EvoGym
        looks at ``grid_width`` alone, and some files have a ``grid_height`` that is too low, or none.

        Raises:
            WorldError: an unreadable file, or an object that cannot be added; no object is added then.
        """
        data, origin = _load_json(source)
        trial = self.copy()
        right = 0
        top = 0
        try:
            for name, cells in read_objects(data).items():
                obj = WorldObject.from_array(name, cells.grid, cells.x, cells.y, cells.connections)
                trial.add_object(obj)
                right = max(right, obj.x + obj.width)
                top = max(top, obj.y + obj.height)
            width = data["grid_width"]
            height = data.get("grid_height", 0)
            if not is_integer(height):
                raise WorldError(f"grid_height must be an integer, got {height!r:.80}.")
            if right <= width and top <= height and width * height <= LARGEST_GRID:
                trial.width = max(trial.width, width)
                trial.height = max(trial.height, height)
                check_size(trial.width, trial.height)
        except WorldError as error:
            raise WorldError(f"{origin}: {error}") from None
        self.objects = trial.objects
        self.width = trial.width
        self.height = trial.height

    @classmethod
    def from_json(cls, source: str | os.PathLike[str] | Mapping[str, object]) -> World:
        """Read a world in EvoGym's format from a path, the text of a file or a parsed dictionary.

        Raises:
            WorldError: unreadable, incomplete or contradictory; the message names the object at fault.
        """
        world = cls()
        world.add_from_json(source)
        return world

    def to_json(self, path: str | os.PathLike[str] | None = None) -> str:
        """Return the world as JSON text in EvoGym's format; also write it to ``path`` if given.

        The format knows filled cells only. Where a bounding box has an empty border, an entry ``box``
        ``[x, y, width, height]`` is added, which this library reads back and EvoGym ignores.

        Raises:
            WorldError: another suffix than .json.
        """
        if path is not None:
            check_suffix("The file of a world", path, (".json",), WorldError)
        text = json.dumps(
            {
                "grid_width": self.width,
                "grid_height": self.height,
                "objects": {name: _object_to_json(obj, self.width) for name, obj in self.objects.items()},
            },
            indent=1,
        )
        if path is not None:
            write_text(path, text + "\n", follow=True)
        return text

    def copy(self) -> World:
        """Return an independent copy of the world; the immutable objects are shared."""
        other = World(self.width, self.height)
        other.objects = dict(self.objects)
        return other

    def key(self) -> bytes:
        """Return a 32-byte digest, equal for equal worlds whatever the order of their objects."""
        digest = hashlib.sha256(f"{self.width} {self.height} {len(self.objects)}".encode())
        for name in sorted(self.objects):
            material = self.objects[name].key()
            digest.update(len(material).to_bytes(8, "little") + material)
        return digest.digest()

    def grid(self) -> np.ndarray:
        """Draw all objects into one int8 array ``[height, width]``, row 0 on top."""
        cells = np.zeros((self.height, self.width), np.int8)
        for obj in self.objects.values():
            top = self.height - obj.y - obj.height
            view = cells[top : top + obj.height, obj.x : obj.x + obj.width]
            np.copyto(view, obj.grid, where=obj.grid != 0)
        return cells

    def pretty(self) -> str:
        """Draw the world in letters: R rigid, S soft, H and V actuators, F fixed, a dot for empty."""
        letters = [EMPTY_LETTER, *(material.letter for material in MATERIALS.values())]
        return "\n".join("".join(letters[cell] for cell in row) for row in self.grid())

    def __eq__(self, other: object) -> bool:
        return self.key() == other.key() if isinstance(other, World) else NotImplemented

    __hash__ = None  # type: ignore[assignment]  # worlds change; use key()

    def __contains__(self, name: object) -> bool:
        return name in self.objects

    def __repr__(self) -> str:
        objects = ", ".join(
            f"{obj.name} {obj.width}x{obj.height} at ({obj.x}, {obj.y})" for obj in self.objects.values()
        )
        return f"World({self.width}x{self.height}: {objects or 'no objects'})"

    def _repr_html_(self) -> str:
        """Draw the world as HTML, for notebooks."""
        return body_svg(self.grid())

    def __str__(self) -> str:
        return f"{self!r}\n{self.pretty()}"

    def _find(self, name: str) -> WorldObject:
        if not isinstance(name, str) or name not in self.objects:
            raise WorldError(
                f"The world has no object '{name}'.{did_you_mean(name, self.objects)} It has {listing(self.objects)}."
            )
        return self.objects[name]

    def _put(self, obj: WorldObject) -> WorldObject:
        """Insert ``obj`` into the world; WorldError: overlap with others, or the world becomes too large."""
        width = max(self.width, obj.x + obj.width)
        height = max(self.height, obj.y + obj.height)
        check_size(width, height, f" with '{obj.name}'")
        self._check_free(obj)
        self.objects.pop(obj.name, None)  # it comes last: read in this order, no box covers what lies there already
        self.objects[obj.name] = obj
        self.width = width
        self.height = height
        return obj

    def _check_free(self, obj: WorldObject) -> None:
        """Raise WorldError if the box of ``obj`` overlaps other objects."""
        for other in self.objects.values():
            if other.name == obj.name:
                continue
            left = max(obj.x, other.x)
            right = min(obj.x + obj.width, other.x + other.width)
            low = max(obj.y, other.y)
            high = min(obj.y + obj.height, other.y + other.height)
            if left >= right or low >= high:
                continue
            top = other.y + other.height
            shared = other.grid[top - high : top - low, left - other.x : right - other.x]
            filled = np.argwhere(shared[::-1])  # lowest row first: the natural place to look at
            if len(filled):
                up, along = filled[0]
                raise WorldError(
                    f"The object '{obj.name}' ({obj.width} wide, {obj.height} high, at ({obj.x}, {obj.y}))"
                    f" overlaps '{other.name}' at cell ({left + along}, {low + up}); its bounding box must"
                    " lie on empty cells."
                )


def check_size(width: int, height: int, why: str = "") -> None:
    """Raise WorldError if a world of this size, in cells, is too large."""
    if width * height > LARGEST_GRID:
        raise WorldError(
            f"The world{why} would have {width} x {height} cells, and {LARGEST_GRID:,} are the limit: choose a smaller"
            " grid or position."
        )


def _check_position(name: str, x: object, y: object) -> tuple[int, int]:
    if not is_integer(x) or not is_integer(y):
        raise WorldError(f"The position of '{name}' must be two integers, in cells, got ({x!r}, {y!r}).")
    if x < 0 or y < 0:
        raise WorldError(f"The position of '{name}' must not be negative, got ({x}, {y}).")
    return int(x), int(y)


def _check_pairs(name: str, grid: np.ndarray, connections: object) -> np.ndarray:
    """Convert EvoGym's ``[2, k]`` connections to unique int32 ``[k, 2]`` pairs a < b, or raise WorldError."""
    try:
        raw = np.asarray(connections)
    except ValueError:
        raise WorldError(f"The connections of '{name}' are ragged: expected two rows of equal length.") from None
    if raw.size == 0:
        return np.zeros((0, 2), np.int32)
    if raw.ndim != 2 or raw.shape[0] != 2 or raw.dtype.kind not in "iuf":
        raise WorldError(
            f"The connections of '{name}' must be numbers of shape [2, k] (pairs of flat cell indices), got"
            f" shape {raw.shape} of {raw.dtype}."
        )
    with np.errstate(invalid="ignore"):
        pairs = np.sort(raw.T.astype(np.int64), axis=1)
    allowed = {tuple(pair) for pair in full_connections(grid).tolist()}
    given = {tuple(pair) for pair in pairs.tolist()}
    wrong = sorted(given - allowed)
    if wrong or not np.array_equal(np.sort(raw.T, axis=1), pairs):
        example = wrong[0] if wrong else "a fraction"
        raise WorldError(
            f"The connections of '{name}' hold {example}, which are not two neighbouring filled cells of its"
            f" {grid.shape[0]}x{grid.shape[1]} grid."
        )
    return np.array(sorted(given), np.int32)


def _load_json(source: object) -> tuple[Mapping[str, Any], str]:
    """Load the dictionary of a world file (path, text or dictionary), and its name for error messages.

    Raises:
        WorldError: there is no such file, or it holds no JSON object.
    """
    if isinstance(source, Mapping):
        return source, "The world"
    if isinstance(source, str) and source.lstrip().startswith("{"):
        origin = "The world text"
        text = source
    elif isinstance(source, (str, os.PathLike)):
        origin = f"The world file '{source}'"
        try:
            text = read_text(source, LARGEST_FILE)
        except Missing:
            raise WorldError(f"There is no world file '{source}'.") from None
        except Unreadable as error:
            raise WorldError(f"{origin} cannot be read: {error}.") from None
    else:
        raise WorldError(f"A world comes from a path, text or a dictionary, got {type(source).__name__}.")
    if len(text) > LARGEST_FILE:
        raise WorldError(f"{origin} has {len(text):,} characters, and {LARGEST_FILE:,} are the limit.")
    try:
        data = parse_json(text, allow_nan=True)
    except Unreadable as error:
        raise WorldError(f"{origin} cannot be read: {error}.") from None
    if not isinstance(data, Mapping):
        raise WorldError(f"{origin} must hold a JSON object, got {type(data).__name__}.")
    return data, origin


def _object_to_json(obj: WorldObject, world_width: int) -> dict[str, object]:
    """Convert an object to an entry of EvoGym's world files."""
    rows, columns = np.nonzero(obj.grid)
    flat = np.flatnonzero(obj.grid).tolist()
    index = {
        cell: int((obj.y + obj.height - 1 - row) * world_width + obj.x + column)
        for cell, row, column in zip(flat, rows, columns, strict=True)
    }
    near: dict[int, list[int]] = {cell: [] for cell in flat}
    for a, b in obj.connections.tolist():
        near[a].append(index[b])
        near[b].append(index[a])
    entry: dict[str, object] = {
        "indices": [index[cell] for cell in flat],
        "types": [int(obj.grid.flat[cell]) for cell in flat],
        "neighbors": {str(index[cell]): near[cell] for cell in flat},
    }
    extent = (rows.min(), columns.min(), rows.max() + 1, columns.max() + 1)
    if extent != (0, 0, obj.height, obj.width):
        entry["box"] = [obj.x, obj.y, obj.width, obj.height]
    return entry
