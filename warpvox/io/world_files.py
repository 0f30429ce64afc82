"""EvoGym's world files: cells and connections of their objects.

A file is ``{"grid_width": W, "grid_height": H, "objects": {name: object}}``, an object ``{"indices": [...], "types":
[...], "neighbors": {index: [index, ...]}}`` with ``index = y * W + x``, where y counts upward from the lowest row. The
width alone says where a cell lies; EvoGym ignores the height.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from warpvox.checks import check_integer, is_integer
from warpvox.errors import WorldError, listing
from warpvox.types import Cell

LARGEST_GRID = 1_000_000
"""Maximum number of cells of a world or object, empty ones included."""
MOST_OBJECTS = 1000
"""Maximum number of objects in a world file."""


@dataclass(frozen=True)
class ObjectCells:
    """The cells and connections of one object in a world file.

    Attributes:
        grid: int8 ``[rows, columns]``, row 0 on top.
        x, y: cell of the lower left corner of ``grid``.
        connections: int64 ``[2, k]``, pairs of flat indices of touching cells of ``grid``.
    """

    grid: np.ndarray
    x: int
    y: int
    connections: np.ndarray


def read_objects(world: Mapping[str, Any]) -> dict[str, ObjectCells]:
    """Read the objects of a parsed world file by name, in the order of the file.

    Raises:
        WorldError: an entry is missing or contradicts another; the message names the object.
    """
    missing = [key for key in ("grid_width", "objects") if key not in world]
    if missing:
        raise WorldError(f"it is not a world: it lacks {listing(missing)}.")
    width = _check_width(world["grid_width"])
    objects = world["objects"]
    if not isinstance(objects, Mapping):
        raise WorldError(f"'objects' must map names to objects, got {type(objects).__name__}.")
    if len(objects) > MOST_OBJECTS:
        raise WorldError(f"there are {len(objects)} objects, and {MOST_OBJECTS} are the limit.")
    found: dict[str, ObjectCells] = {}
    total = 0
    for name, entry in objects.items():
        cells = read_object(name, entry, width)
        if not len(entry["indices"]) == len(entry["types"]) == len(entry["neighbors"]):
            raise WorldError(
                f"the object '{name}' must have as many types and neighbors as indices; it has"
                f" {len(entry['indices'])} indices, {len(entry['types'])} types, {len(entry['neighbors'])} neighbors."
            )
        total += cells.grid.size
        if total > 2 * LARGEST_GRID:
            raise WorldError(f"the boxes of the objects have more than {2 * LARGEST_GRID:,} cells together.")
        found[name] = cells
    return found


def read_object(name: str, entry: Any, grid_width: object) -> ObjectCells:
    """Read the cells of one object of a world file ``grid_width`` cells wide.

    As in EvoGym, a cell of type 0 is empty and makes the box larger, and neighbors that do not touch are not connected.
    An entry ``box`` ``[x, y, width, height]`` makes the box larger, too.

    Raises:
        WorldError: an entry is missing or contradicts another.
    """
    width = _check_width(grid_width)
    if not isinstance(entry, Mapping) or not all(key in entry for key in ("indices", "types", "neighbors")):
        raise WorldError(f"the object '{name}' needs the entries indices, types and neighbors.")
    indices = entry["indices"]
    types = entry["types"]
    neighbors = entry["neighbors"]
    if not (isinstance(indices, list | tuple) and isinstance(types, list | tuple) and isinstance(neighbors, Mapping)):
        raise WorldError(f"the object '{name}' needs lists of indices and types and a mapping of neighbors.")
    if not indices or len(types) < len(indices):
        raise WorldError(
            f"the object '{name}' must have at least one index, and as many types and neighbors as indices; it has"
            f" {len(indices)} indices and {len(types)} types."
        )

    # Type of each cell
    known = {int(cell) for cell in Cell}
    cells: dict[int, int] = {}
    for index, cell in zip(indices, types, strict=False):
        if not is_integer(index) or index < 0:
            raise WorldError(f"the indices of the object '{name}' must be integers >= 0, got {index!r:.80}.")
        if not _is_one_of(cell, known):
            raise WorldError(f"the cell type {cell!r:.80} of '{name}' at index {index} is none of 0 to {max(known)}.")
        if cells.setdefault(index, int(cell)) != cell:
            raise WorldError(f"the object '{name}' has two types at index {index}: {cells[index]} and {cell}.")

    # Grid
    columns = [index % width for index in cells]
    rows = [index // width for index in cells]
    x = min(columns)
    y = min(rows)
    right = max(columns) + 1
    top = max(rows) + 1
    box = entry.get("box")
    if box is not None:
        # The box must hold the cells.
        is_box = isinstance(box, list) and len(box) == 4 and all(is_integer(n) and n >= 0 for n in box)
        if not is_box or box[0] > x or box[1] > y or box[0] + box[2] < right or box[1] + box[3] < top:
            raise WorldError(
                f"the box {box!r:.80} of the object '{name}' is no [x, y, width, height] that holds its cells."
            )
        x = box[0]
        y = box[1]
        right = x + box[2]
        top = y + box[3]
    box_width = right - x
    box_height = top - y
    if box_width * box_height > LARGEST_GRID:
        raise WorldError(
            f"the box of the object '{name}' has {box_width} x {box_height} cells, and {LARGEST_GRID:,} are the limit."
        )
    places = [(y + box_height - 1 - row) * box_width + column - x for column, row in zip(columns, rows, strict=True)]
    grid = np.zeros((box_height, box_width), np.int8)
    grid.flat[places] = list(cells.values())

    # Connections
    place_of = dict(zip(cells, places, strict=True))
    pairs: list[tuple[int, int]] = []
    for index, place in place_of.items():
        near = neighbors.get(str(index), neighbors.get(index))
        if not isinstance(near, list | tuple) or not all(_is_one_of(other, place_of) for other in near):
            raise WorldError(f"the neighbors of index {index} of '{name}' are not a list of its indices.")
        for other in near:
            if cells[index] == Cell.EMPTY or cells[int(other)] == Cell.EMPTY:
                continue
            if _touch(name, place, place_of[int(other)], box_width):
                pairs.append((place, place_of[int(other)]))
    return ObjectCells(grid, x, y, np.array(pairs, np.int64).reshape(-1, 2).T)


def _check_width(value: object) -> int:
    width = check_integer("grid_width", value, 1, error=WorldError)
    if width > LARGEST_GRID:
        raise WorldError(f"grid_width is {width}, and {LARGEST_GRID:,} are the limit.")
    return width


def _is_one_of(value: object, options: Collection[int]) -> bool:
    """Return whether a number, possibly written as 3.0, is one of ``options``; True does not count as 1."""
    return (is_integer(value) or isinstance(value, float)) and value in options


def _touch(name: str, first: int, second: int, width: int) -> bool:
    """Return whether two cells (flat indices) of a grid ``width`` cells wide touch along an edge.

    WorldError: they lie at opposite ends of neighbouring rows, one after the other. EvoGym takes them for neighbours in
    a row and joins their far corners.
    """
    low, high = sorted((first, second))
    if high - low == 1 and high % width == 0 and width > 1:
        raise WorldError(
            f"the object '{name}' connects cells at opposite ends of two rows, which are not two neighbouring filled"
            " cells."
        )
    return high - low == width or high - low == 1
