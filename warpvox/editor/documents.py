"""Documents of the design editor: a body or a world, drawn on one grid of cells.

A document is a JSON object: ``kind`` ("body" or "world"), ``names`` (of the objects; a body has one, "robot"),
``types`` (rows of cells, row 0 on top) and ``owners`` (rows of the same size: which of the names a cell belongs
to; entries of empty cells mean nothing).
"""

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from warpvox.design import Design, as_grid, check_design, count_pieces, full_connections
from warpvox.errors import DesignError, WarpvoxError, WorldError, counted, did_you_mean, listing
from warpvox.io.reading import Unreadable, parse_json, read_text
from warpvox.io.writing import write_text
from warpvox.system import is_device_name
from warpvox.types import Cell
from warpvox.world import World, WorldObject

BODY_SIDE = 32
"""Maximum number of rows and of columns of a body in the editor."""
WORLD_SIZE = (400, 100)
"""Maximum number of columns and rows of a world in the editor."""
_OBJECTS = 64
_FILE_NAME = re.compile(r"[^\W_][\w.-]{0,63}")


def design_of(document: Mapping[str, Any]) -> Design:
    """Convert a document to a body, cropped to its filled cells."""
    cells = _cells(document, BODY_SIDE, BODY_SIDE)
    return check_design(cells[_box(cells)] if cells.any() else cells)


def world_of(document: Mapping[str, Any]) -> World:
    """Convert a document to a world.

    Objects are added from the largest to the smallest: the bounding box of an object must lie on cells that are
    free of those before it, and terrain may well reach around a robot.
    """
    types = _cells(document, WORLD_SIZE[1], WORLD_SIZE[0], WorldError)
    names = document.get("names")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise WorldError("names must be a list of texts, one or more.")
    if len(names) > _OBJECTS or any(not 0 < len(name) <= 64 for name in names):
        raise WorldError(f"There may be up to {_OBJECTS} objects with names of 1 to 64 letters.")
    if len(set(names)) < len(names):
        raise WorldError(f"The names of objects must differ; they are {listing(names)}.")
    height, width = types.shape

    # Whose each cell is: the number of a name
    value = document.get("owners")
    if not (
        isinstance(value, list)
        and len(value) == height
        and all(isinstance(row, list) and len(row) == width for row in value)
        and all(type(entry) is int and 0 <= entry < len(names) for row in value for entry in row)
    ):
        raise WorldError("owners must have an entry for every cell, the number of one of the names.")
    owners = np.array(value, np.int16).reshape(types.shape)

    # Objects
    objects = []
    for number, name in enumerate(names):
        cells = np.where(owners == number, types, Cell.EMPTY)
        if cells.any():
            rows, columns = box = _box(cells)
            objects.append(WorldObject.from_array(name, cells[box], int(columns.start), int(height - rows.stop)))
    if not objects:
        raise WorldError("The world is empty: paint something.")
    world = World(width, height)
    for obj in sorted(objects, key=lambda item: -item.width * item.height):
        world.add_object(obj)
    return world


def document_of(content: Design | World) -> dict[str, Any]:
    """Convert a body or a world to a document of the editor."""
    if not isinstance(content, World):
        grid = np.asarray(content)
        return _document("body", ["robot"], grid, np.zeros_like(grid))
    if content.width > WORLD_SIZE[0] or content.height > WORLD_SIZE[1] or len(content.objects) > _OBJECTS:
        raise WorldError(
            f"The editor shows worlds of up to {WORLD_SIZE[0]} x {WORLD_SIZE[1]} cells and {_OBJECTS} objects; this one"
            f" has {content.width} x {content.height} and {len(content.objects)}."
        )
    types, owners = np.zeros((2, content.height, content.width), np.int16)
    for number, obj in enumerate(content.objects.values()):
        if len(obj.connections) < len(full_connections(obj.grid)):
            raise WorldError(
                f"'{obj.name}' has neighbouring cells that are not connected, which the editor cannot show."
            )
        top = content.height - obj.y - obj.height
        box = slice(top, top + obj.height), slice(obj.x, obj.x + obj.width)
        filled = obj.grid != Cell.EMPTY
        types[box][filled] = obj.grid[filled]
        owners[box][filled] = number
    return _document("world", list(content.objects) or ["object"], types, owners)


def check(document: Mapping[str, Any]) -> str:
    """Validate a document and describe it in a sentence; DesignError, WorldError: it is not valid."""
    if _kind(document) == "body":
        body = design_of(document)
        cells = counted((body > 0).sum(), "cells")
        actuators = counted((body >= Cell.H_ACT).sum(), "actuators")
        return f"A valid robot: {body.shape[0]} x {body.shape[1]}, {cells}, {actuators}."
    world = world_of(document)
    parts = []
    for obj in world.objects.values():
        kind = "robot" if obj.is_robot else "terrain" if obj.is_static else "object"
        pieces = count_pieces(obj.grid)
        apart = f", {pieces} pieces" if pieces > 1 and not obj.is_static else ""
        parts.append(f"{obj.name} ({kind}, {counted(int((obj.grid > 0).sum()), 'cells')}{apart})")
    return f"A valid world of {world.width} x {world.height}: {', '.join(parts)}."


def check_file_name(name: object) -> str:
    """Return ``name`` as a file name with its suffix; WorldError if it cannot be a file name."""
    stem = name.removesuffix(".json") if isinstance(name, str) else ""
    # The file system takes it with its suffix and a temporary one beside it.
    if not _FILE_NAME.fullmatch(stem) or len(stem.encode()) > 200:
        raise WorldError(
            "A name may hold up to 64 letters, digits and . _ - (no folder) and begins with a letter or digit; got"
            f" {name!r:.80}."
        )
    if is_device_name(stem):
        raise WorldError(f"Windows keeps the name {stem!r} for a device: choose another one.")
    return f"{stem}.json"


def file_names(folder: Path) -> list[str]:
    """List the JSON files in a folder that the editor can open."""
    return sorted(path.name for path in folder.glob("*.json") if _FILE_NAME.fullmatch(path.stem) and _is_here(path))


def _is_here(path: Path) -> bool:
    """Return whether a file lies in its folder itself, not behind a link to another folder."""
    return path.is_file() and path.resolve().parent == path.parent.resolve()


def save_file(document: Mapping[str, Any], folder: Path, name: object, overwrite: bool = False) -> Path:
    """Write a document in EvoGym's world format; return the path.

    A body becomes a world that holds the robot alone. An entry ``body`` with its rows, which EvoGym ignores, lets
    ``design=FILE`` read it, too.
    """
    path = folder / check_file_name(name)
    if _kind(document) == "body":
        body = design_of(document)
        world = World(body.shape[1], body.shape[0])
        world.add_from_array("robot", body, 0, 0)
        text = json.dumps(json.loads(world.to_json()) | {"body": body.tolist()})
    else:
        text = world_of(document).to_json()
    if os.path.lexists(path) and not overwrite:  # a link that leads nowhere, too
        raise FileExistsError(path.name)
    write_text(path, text + "\n")
    return path


def read_file(path: Path) -> dict[str, Any]:
    """Read a document from a file: a body (rows of cells, or ``{"body": rows}``) or a world in EvoGym's format."""
    if not _is_here(path):
        near = did_you_mean(path.stem, (name.removesuffix(".json") for name in file_names(path.parent)))
        raise WorldError(f"There is no file '{path.name}' in {path.parent}.{near}")
    try:
        content = parse_json(read_text(path, 4_000_000), allow_nan=True)
    except Unreadable as error:
        raise WorldError(f"'{path.name}' is not a JSON file that the editor can read: {error}.") from None
    if isinstance(content, dict) and "body" not in content:
        return document_of(World.from_json(content))
    body = as_grid(content["body"] if isinstance(content, dict) else content)
    if max(body.shape) > BODY_SIDE:
        raise DesignError(f"The editor shows bodies of up to {BODY_SIDE} x {BODY_SIDE} cells.")
    return document_of(body)


def _document(kind: str, names: list[str], types: np.ndarray, owners: np.ndarray) -> dict[str, Any]:
    return {"kind": kind, "names": names, "types": types.tolist(), "owners": owners.tolist()}


def _kind(document: Mapping[str, Any]) -> str:
    kind = document.get("kind")
    if kind not in ("body", "world"):
        raise WorldError(f"A document is a body or a world, got {kind!r:.80}.")
    return kind


def _cells(document: Mapping[str, Any], rows: int, columns: int, error: type[WarpvoxError] = DesignError) -> np.ndarray:
    """Return the cells of a document as an array; raise ``error`` if they are invalid or too many."""
    value = document.get("types")
    # Before numpy looks at it: what is not a rectangle of a modest size is not worth an array.
    if not isinstance(value, list) or not all(isinstance(row, list) for row in value):
        raise error("types must be rows of cells.")
    if len(value) > rows or any(len(row) > columns for row in value):
        raise error(f"There is room for {columns} columns and {rows} rows.")
    return as_grid(value, what="grid", error=error)


def _box(filled: np.ndarray) -> tuple[slice, slice]:
    """Return the row and column slices of the bounding box of all filled cells."""
    rows = np.flatnonzero(filled.any(1))
    columns = np.flatnonzero(filled.any(0))
    return slice(*rows[[0, -1]] + (0, 1)), slice(*columns[[0, -1]] + (0, 1))
