"""Robot bodies ("designs"): int8 arrays ``[rows, columns]`` of :class:`warpvox.types.Cell`, row 0 on top.

A body is valid if it is one piece (cells touch along edges) and holds at least one actuator (paper section
A.1 and C.1). This module checks, samples, loads and saves bodies; it needs numpy only.
"""

import math
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np

from warpvox.checks import check_shape, design_of
from warpvox.errors import DesignError, RunError, WorldError, did_you_mean, listing
from warpvox.examples import EXAMPLES, bare_id
from warpvox.io.reading import (
    CONFIG,
    SUMMARY,
    ArrayFile,
    Missing,
    Unreadable,
    parse_json,
    read_bytes,
    read_config,
    read_facts,
    read_npy,
    read_text,
)
from warpvox.io.world_files import LARGEST_GRID, read_objects
from warpvox.io.writing import atomic_path, check_suffix, write_text
from warpvox.types import ACTUATORS, MATERIALS, Cell

Design: TypeAlias = np.ndarray
"""int8 ``[rows, columns]``, row 0 on top, entries are :class:`warpvox.types.Cell`."""

SAMPLING_WEIGHTS = (0.6, 0.2, 0.2, 0.2, 0.2)
"""EvoGym's relative weights of empty, rigid, soft, horizontal and vertical actuator cells (sum 1.4)."""

_LARGEST_BODY = 1 << 16
"""Maximum number of cells of a body, empty ones included (256 x 256)."""
_LARGEST_FILE = 4_000_000
"""Maximum size in bytes of a design file, its arrays or its text."""

ZOO_FOLDER = Path(__file__).parent / "data"
"""Folder of the zoo, with a stored robot ``TASK.npz`` for every task."""

DESIGN_SUFFIXES = (".json", ".npz", ".npy")
"""Suffixes of files that always hold a design, and that :func:`save_design` writes."""

_EXPECTED = (
    f"a design is a file ({', '.join(DESIGN_SUFFIXES)}), a text with a row of cell types on each line as numpy.savetxt"
    " writes it, a folder with body.npy, or the folder of a run"
)


def check_design(body: object) -> Design:
    """Validate a robot body and return a fresh int8 array ``[rows, columns]``.

    Accepts an array or nested lists; floating-point entries are fine as long as they are integers.

    Raises:
        DesignError: not two-dimensional, empty, too large (:data:`_LARGEST_BODY`), an unknown cell type (with its
            place), a fixed cell, more than one piece, or no actuator.
    """
    grid = as_grid(body, limit=_LARGEST_BODY)
    if not grid.any():
        raise DesignError(f"The body ({_size(grid)}) is empty: it needs at least one cell that is not 0.")
    fixed = np.argwhere(grid == Cell.FIXED)
    if len(fixed):
        row, column = fixed[0]
        raise DesignError(
            f"The body holds a fixed cell ({int(Cell.FIXED)}) at row {row}, column {column}; a robot is made"
            f" of {_cell_names(robot_only=True)}."
        )
    pieces = count_pieces(grid)
    if pieces > 1:
        raise DesignError(
            f"The body is not connected: it falls into {pieces} pieces. All cells must hang together along"
            " edges (touching at a corner does not count)."
        )
    if not has_actuator(grid):
        raise DesignError(
            f"The body has no actuator: at least one cell must be {int(Cell.H_ACT)} (horizontal) or"
            f" {int(Cell.V_ACT)} (vertical)."
        )
    return grid


def as_grid(
    cells: object, *, what: str = "body", error: type[Exception] = DesignError, limit: int = LARGEST_GRID
) -> np.ndarray:
    """Convert ``cells`` to a fresh int8 array ``[rows, columns]`` of known cell types, or raise ``error``.

    This is the part of the check that robots share with every other object of a world.

    Args:
        limit: cells at most.
    """
    cells = design_of(cells)

    # Texts and further lists are refused before numpy makes an array of the rows: beside one long text it would take as
    # much memory for every number.
    if isinstance(cells, list | tuple):
        for row in cells:
            for cell in row if isinstance(row, list | tuple) else [row]:
                if isinstance(cell, str | bytes):
                    raise error(f"The {what} must hold numbers (cell types 0 to {int(max(Cell))}), got {cell!r:.60}.")
                if isinstance(cell, list | tuple):
                    raise error(f"The {what} must have two dimensions [rows, columns], got lists inside of its rows.")
    try:
        raw = np.asarray(cells)
    except ValueError:  # numpy's word for nested lists of unequal length
        raise error(f"The {what} is ragged: every row must have the same number of cells.") from None
    except Exception as reason:  # conversion of an arbitrary object may raise anything
        raise error(f"The {what} cannot be read as an array: {type(reason).__name__}: {reason}.") from None
    if raw.dtype.kind not in "iuf":
        kind = type(cells).__name__ if raw.ndim == 0 else raw.dtype
        raise error(f"The {what} must hold numbers (cell types 0 to {int(max(Cell))}), got {kind}.")
    if raw.ndim != 2:
        raise error(f"The {what} must have two dimensions [rows, columns], got shape {raw.shape}.")
    if raw.size == 0:
        raise error(f"The {what} has no cells: its shape is {raw.shape}.")
    if raw.size > limit:
        raise error(f"The {what} is too large: {_size(raw)} cells, and {limit:,} are the limit.")
    known = (raw >= 0) & (raw <= int(max(Cell))) & (raw == np.floor(raw))
    if not known.all():
        row, column = np.argwhere(~known)[0]
        raise error(
            f"The {what} holds an unknown cell type {raw[row, column]} at row {row}, column {column};"
            f" known are {_cell_names()}."
        )
    return raw.astype(np.int8)


def has_actuator(body: object) -> bool:
    """Return whether any cell is a horizontal or vertical actuator."""
    cells = as_grid(body)
    return bool(np.isin(cells, ACTUATORS).any())


def count_pieces(bodies: np.ndarray) -> np.ndarray:
    """Count the edge-connected pieces of each of the bodies ``[..., rows, columns]``, int ``[...]``."""
    *batch, rows, columns = bodies.shape
    grid = np.zeros((math.prod(batch), rows + 1, columns), bool)  # an empty row keeps bodies apart
    grid[:, :-1] = bodies.reshape(-1, rows, columns) != Cell.EMPTY
    root = _pieces(grid.reshape(-1, columns))
    roots = (root == np.arange(grid.size)) & grid.reshape(-1)
    return roots.reshape(*batch, (rows + 1) * columns).sum(-1)


def _pieces(grid: np.ndarray) -> np.ndarray:
    """Label every cell of ``grid`` with the first cell (row-major) of its connected piece, int ``[cells]``."""
    first, second = full_connections(grid).T
    root = np.arange(grid.size)
    while True:  # cells point to a cell of their piece with a smaller index: join ends of connections, then shorten
        a = root[first]
        b = root[second]
        if np.array_equal(a, b):
            return root
        np.minimum.at(root, np.maximum(a, b), np.minimum(a, b))
        while not np.array_equal(root, shorter := root[root]):
            root = shorter


def repair_design(body: object) -> Design:
    """Turn any body into a valid design; a valid body is returned unchanged.

    Of the pieces with an actuator the largest is kept, the first one in row-major order among equals. If none has an
    actuator, the largest piece is kept, and its first cell becomes a horizontal actuator. A body without voxels becomes
    a single horizontal actuator at ``[rows // 2, columns // 2]``.

    Raises:
        DesignError: not a grid of the cells that robots are made of.
    """
    grid = np.ascontiguousarray(as_grid(body, limit=_LARGEST_BODY))
    if not grid.any():
        grid[grid.shape[0] // 2, grid.shape[1] // 2] = Cell.H_ACT
    cells = grid.reshape(-1)
    piece = _pieces(grid)
    sizes = np.bincount(piece[cells != Cell.EMPTY], minlength=cells.size)
    driven = np.zeros_like(sizes)
    driven[piece[np.isin(cells, ACTUATORS)]] = 1
    kept = (sizes * driven if driven.any() else sizes).argmax()
    cells[piece != kept] = Cell.EMPTY
    if not driven.any():
        cells[kept] = Cell.H_ACT
    return check_design(grid)


def are_valid(bodies: np.ndarray) -> np.ndarray:
    """Test which of the bodies ``[n, rows, columns]`` are connected and have an actuator, bool ``[n]``."""
    driven = (bodies == Cell.H_ACT) | (bodies == Cell.V_ACT)
    actuated = driven.any((1, 2))
    actuated[actuated] = count_pieces(bodies[actuated]) == 1
    return actuated


def full_connections(grid: np.ndarray) -> np.ndarray:
    """List all pairs of edge-adjacent non-empty cells of ``grid`` ``[rows, columns]`` as int32 ``[k, 2]``.

    Entries are flat (row-major) indices, smaller one first. Pairs come in row-major order of their first
    cell, its right-hand neighbour before its lower one.
    """
    solid = np.asarray(grid) != 0
    number = np.arange(solid.size, dtype=np.int32).reshape(solid.shape)
    right = number[:, :-1][solid[:, :-1] & solid[:, 1:]]
    below = number[:-1][solid[:-1] & solid[1:]]
    first = np.concatenate([right, below])
    second = np.concatenate([right + 1, below + solid.shape[1]])
    order = np.argsort(first, kind="stable")  # stable: keeps "right before below" for pairs of one cell
    return np.stack([first[order], second[order]], axis=1)


def sample_design(
    shape: tuple[int, int] = (5, 5),
    seed: int | np.random.Generator | None = None,
    probabilities: Sequence[float] | None = None,
) -> Design:
    """Sample a valid body by EvoGym's rule: independent cells, until the body is connected and has an actuator.

    From about 13 x 13 cells on hardly any such body is connected. Where none is found, the last one drawn is repaired:
    its largest piece with an actuator is kept (see :func:`repair_design`).

    Args:
        shape: ``(rows, columns)``.
        seed: an integer for a reproducible body, a numpy Generator to continue its stream, None for a
            fresh one.
        probabilities: relative weights of (empty, rigid, soft, horizontal, vertical); EvoGym's 0.6,
            0.2, 0.2, 0.2, 0.2 by default.

    Raises:
        DesignError: a bad shape, seed or weights, or weights under which hardly any body has an actuator.
    """
    rows, columns = check_shape("shape", shape, DesignError)
    if rows * columns > _LARGEST_BODY:
        raise DesignError(f"The shape {rows}x{columns} is too large: a body has at most {_LARGEST_BODY:,} cells.")
    weights = _check_weights(SAMPLING_WEIGHTS if probabilities is None else probabilities)
    try:
        rng = np.random.default_rng(seed)
    except (TypeError, ValueError):
        raise DesignError(f"The seed must be None, an integer >= 0 or a numpy Generator, got {seed!r}.") from None
    # One body per draw, so that a shared Generator advances by the draws that were needed.
    draws = max(1, 2_000_000 // (rows * columns))
    for _ in range(draws):
        body = draw_bodies(rng, 1, (rows, columns), weights)
        if are_valid(body)[0]:
            return body[0]
    if has_actuator(body[0]):
        return repair_design(body[0])
    raise DesignError(
        f"No {rows}x{columns} body with an actuator turned up in {draws} draws with the weights"
        f" {tuple(round(float(w), 4) for w in weights)}: give actuators (the last two) more."
    )


def draw_bodies(
    rng: np.random.Generator,
    count: int,
    shape: tuple[int, int],
    weights: Sequence[float] | np.ndarray = SAMPLING_WEIGHTS,
) -> np.ndarray:
    """Sample bodies, valid or not, int8 ``[count, rows, columns]``: independent cells with relative weights."""
    cumulative = np.cumsum(weights) / np.sum(weights)
    return np.searchsorted(cumulative[:-1], rng.random((count, *shape)), side="right").astype(np.int8)


def example_designs() -> dict[str, Design]:
    """Return fresh copies of all example bodies by name."""
    return {name: np.array(rows, dtype=np.int8) for name, rows in EXAMPLES.items()}


def example_design(name: str) -> Design:
    """Return a fresh copy of one example body, for instance ``"walker"``.

    Raises:
        DesignError: no example has this name; the message lists them.
    """
    if name not in EXAMPLES:
        raise DesignError(
            f"There is no example design '{name}'.{did_you_mean(name, EXAMPLES)} Known: {listing(EXAMPLES)}."
        )
    return np.array(EXAMPLES[name], dtype=np.int8)


def load_design(spec: object, seed: int | np.random.Generator | None = 0) -> Design:
    """Load a valid body from a name, file, folder, array, run or robot.

    ``spec`` is one of: the name of an example (``walker``); ``random`` or ``random:ROWSxCOLUMNS`` (drawn with
    ``seed``); ``zoo:TASK``, the body of a stored robot; the path of a file (.json, .npz, .npy, or a text as
    :func:`numpy.savetxt` writes it) or of a folder with ``body.npy`` or a single design file; the folder of a run or of
    a design search (its best body), or a checkpoint in one; the text of a nested list (``[[3,3],[4,4]]``); a nested
    list or an array; or what has a body as ``design``: a robot of :func:`warpvox.zoo`, a policy, a result of
    :func:`warpvox.train` or :func:`warpvox.codesign` or one of its designs. A name comes before a file of the same
    name.

    Raises:
        DesignError: nothing of the kind, an unreadable file, or a body that is not valid.
    """
    spec = design_of(spec)
    if isinstance(spec, os.PathLike):
        return _read_path(Path(spec))
    if not isinstance(spec, str):
        return check_design(spec)
    text = spec.strip()
    if text.startswith("["):
        return check_design(_parse_list(text, source=f"The text '{_shorten(text)}'"))
    if text.startswith("zoo:"):
        return _read_path(zoo_file(text.removeprefix("zoo:"), DesignError))
    if text == "random" or text.startswith("random:"):
        size = re.fullmatch(r"random(:(\d{1,9})[xX](\d{1,9}))?", text)
        if size is None:
            raise DesignError(
                f"Cannot read the size in '{_shorten(text)}': expected random:ROWSxCOLUMNS, e.g. random:5x7."
            )
        return sample_design((int(size[2] or 5), int(size[3] or 5)), seed)
    if text in EXAMPLES:
        return example_design(text)
    path = os.path.expanduser(text)
    if text.lower().endswith(DESIGN_SUFFIXES) or os.path.exists(path):
        return _read_path(Path(path))
    raise DesignError(
        f"Unknown design '{_shorten(text)}'.{did_you_mean(text, [*EXAMPLES, 'random'])} Expected an example"
        f" ({listing(EXAMPLES)}), random, random:5x7, zoo:TASK, a nested list such as [[3,3],[4,4]] or a path:"
        f" {_EXPECTED}."
    )


def design_paths(folder: Path) -> list[Path]:
    """List the designs in a folder by name: files with :data:`DESIGN_SUFFIXES` and folders with ``body.npy``.

    Also those of its folder ``structure``, where EvoGym's searches keep the designs of a generation. A folder that has
    ``body.npy`` is a single design itself.
    """
    if (folder / "body.npy").is_file():
        return [folder]
    places = [folder, folder / "structure"]
    entries = sorted(entry for place in places if place.is_dir() for entry in place.iterdir())
    return [
        entry
        for entry in entries
        if (entry.is_file() and entry.suffix.lower() in DESIGN_SUFFIXES) or (entry / "body.npy").is_file()
    ]


def zoo_tasks() -> list[str]:
    """List the ids of the tasks with a robot in the zoo."""
    return sorted(path.stem for path in ZOO_FOLDER.glob("[!.]*.npz"))


def zoo_file(name: str | os.PathLike[str], error: type[Exception]) -> Path:
    """Return the path of the zoo's robot for a task, or ``name`` itself if it is an ``.npz`` file."""
    if not isinstance(name, str | os.PathLike):
        raise error(f"A robot of the zoo is named by its task, got {name!r:.80}.")
    text = bare_id(os.fspath(name))
    if text.lower().endswith(".npz"):
        return Path(text).expanduser()
    known = zoo_tasks()
    if text not in known:
        raise error(f"The zoo has no robot for {text!r:.80}.{did_you_mean(text, known)} It has {listing(known, 40)}.")
    return ZOO_FOLDER / f"{text}.npz"


def save_design(path: str | os.PathLike[str], body: object) -> Path:
    """Validate a body and write it to ``path`` atomically; return the path.

    ``.json`` holds ``{"body": [[...]]}``; ``.npz`` is EvoGym's structure file (``arr_0`` the body, ``arr_1``
    its connections ``[2, k]``); ``.npy`` the bare array.

    Raises:
        DesignError: the body is not valid, or the suffix is none of these.
    """
    grid = check_design(body)
    target = Path(path)
    suffix = check_suffix("The file of a design", path, DESIGN_SUFFIXES, DesignError)
    if suffix == ".json":
        rows = ",\n  ".join(str(row) for row in grid.tolist())
        write_text(target, f'{{"body": [\n  {rows}\n]}}\n', follow=True)
    elif suffix == ".npz":
        # Into an open file: numpy would add its suffix to one in capitals.
        with atomic_path(target, follow=True) as temporary, open(temporary, "wb") as file:
            np.savez(file, grid, full_connections(grid).T)
    else:
        with atomic_path(target, follow=True) as temporary, open(temporary, "wb") as file:
            np.save(file, grid)
    return target


def _run_folder(path: Path) -> Path:
    """Return the folder of a run, given the folder or a checkpoint in it."""
    path = path.expanduser()
    return path.parent if path.suffix == ".pt" else path


def _read_path(path: Path) -> Design:
    """Read a design from a file, a folder or a run."""
    # The body of a training, or the best one of a design search
    folder = _run_folder(path)
    if os.path.isfile(folder / CONFIG):  # False of any path, however long
        try:
            config = read_config(folder)
        except RunError as error:
            raise DesignError(str(error)) from None
        of_search = "search" in config
        body = (read_facts(folder / SUMMARY) if of_search else config).get("design")
        many = config.get("designs")
        if isinstance(many, dict) and many.get("bodies") is not None:
            raise DesignError(f"The run {path} has many bodies: give one of them.")
        if not isinstance(body, list):
            what = "has evaluated no design yet" if of_search else "says no single body"
            raise DesignError(f"The run {path} {what}.")
        return check_design(body)

    # The design of a file or a folder
    try:
        body, connections = _read_folder(path) if os.path.isdir(path) else _read_file(path)
    except Missing:
        if os.path.exists(path):
            raise DesignError(f"'{path}' is neither a file nor a folder; {_EXPECTED}.") from None
        raise DesignError(f"There is no design file '{path}'.") from None
    except Unreadable as error:
        raise DesignError(f"The design file '{path}' cannot be read: {error}.") from None
    except OSError as error:
        raise DesignError(f"The folder '{path}' cannot be read: {error.strerror or error}.") from None

    # A body alone means "all neighbours are connected"; dropping cuts silently would be another robot.
    if connections is not None and isinstance(body, np.ndarray) and body.ndim == 2:
        if connections.size and (connections.shape[:-1] != (2,) or not np.isfinite(connections).all()):
            raise DesignError(
                f"The design file '{path}' has connections that are not pairs of cells [2, k]: got shape"
                f" {connections.shape} of {connections.dtype}."
            )
        connected = {tuple(sorted(pair)) for pair in connections.T.tolist()}
        cuts = {tuple(pair) for pair in full_connections(body).tolist()} - connected
        if cuts:
            raise DesignError(
                f"The design file '{path}' leaves {len(cuts)} pair(s) of neighbouring cells unconnected,"
                " which a design cannot say; use World.add_from_array(..., connections=...) instead."
            )
    try:
        return check_design(body)
    except DesignError as error:
        raise DesignError(f"The design file '{path}' holds no valid robot. {error}") from None


def _read_folder(folder: Path) -> tuple[object, np.ndarray | None]:
    """Read cells and connections (None: not stored) from a folder with one design."""
    if (folder / "body.npy").is_file():
        pairs = folder / "connections.npy"
        connections = read_npy(pairs, _LARGEST_FILE) if pairs.is_file() else None
        return read_npy(folder / "body.npy", _LARGEST_FILE), connections
    found = design_paths(folder)
    if not found:
        entries = sorted(entry.name for entry in folder.iterdir())
        content = f"holds no design, but {listing(entries, 5)}" if entries else "is empty"
        raise DesignError(f"The folder '{folder}' {content}; {_EXPECTED}.")
    if len(found) > 1:
        raise DesignError(f"The folder '{folder}' holds {len(found)} designs: name one of them, such as '{found[0]}'.")
    return _read_folder(found[0]) if found[0].is_dir() else _read_file(found[0])


def _read_file(path: Path) -> tuple[object, np.ndarray | None]:
    """Read cells and connections (None: not stored) from a file."""
    suffix = path.suffix.lower()
    if suffix not in DESIGN_SUFFIXES:
        # How the file begins says what it is.
        data = read_bytes(path, _LARGEST_FILE)
        signatures = {b"{": ".json", b"[": ".json", b"PK\x03\x04": ".npz", b"\x93NUMPY": ".npy"}
        for start, kind in signatures.items():
            if data.lstrip().startswith(start):
                suffix = kind
                break
        else:
            return _parse_grid(data), None
    if suffix == ".json":
        return _parse_list(read_text(path, _LARGEST_FILE), source=f"The design file '{path}'"), None
    if suffix == ".npy":
        return read_npy(path, _LARGEST_FILE), None
    with ArrayFile(path, _LARGEST_FILE) as archive:
        name = next((key for key in ("arr_0", "body", "structure") if key in archive.names), None)
        if name is None:
            raise DesignError(
                f"The design file '{path}' has no array 'arr_0' or 'body'; it holds {listing(archive.names)}."
            )
        pairs = {"arr_0": "arr_1", "body": "connections"}.get(name)  # of EvoGym, of a stored robot
        return archive.read(name), archive.read(pairs) if pairs in archive.names else None


def _parse_grid(data: bytes) -> list[list[float]]:
    """Parse rows of cells from text: numbers separated by blanks, commas or semicolons, or single digits.

    What follows ``#`` on a line is a comment. Unreadable: another text, or none.
    """
    if b"\0" in data:
        raise Unreadable(f"it is neither text nor an array; {_EXPECTED}")
    rows: list[list[float]] = []
    for number, line in enumerate(data.decode("utf-8-sig", "replace").splitlines(), 1):  # comments may be in Latin-1
        content = line.partition("#")[0].strip()
        if not content:
            continue
        cells = list(content) if content.isdecimal() else re.split(r"[\s,;]+", content.strip(",; "))
        try:
            rows.append([float(cell) for cell in cells])
        except ValueError:
            raise Unreadable(f"its line {number} is no row of cell types, {content!r:.60}; {_EXPECTED}") from None
    if not rows:
        raise Unreadable(f"it is empty; {_EXPECTED}")
    return rows


def _parse_list(text: str, source: str) -> object:
    """Parse cells from a JSON text: nested lists, an entry ``body``, or a world with one robot."""
    try:
        if len(text) > _LARGEST_FILE:
            raise Unreadable(f"it has {len(text):,} characters, and {_LARGEST_FILE:,} are the limit")
        value = parse_json(text, allow_nan=True)
    except Unreadable as error:
        raise DesignError(f"{source} is not a nested list of cell types such as [[3,3],[4,4]]: {error}.") from None
    if isinstance(value, dict):
        if "body" in value:
            return value["body"]
        if "objects" in value:
            return _extract_robot(value, source)
        raise DesignError(f"{source} has no entry 'body'; it has {listing(value)}.")
    return value


def _extract_robot(world: dict, source: str) -> np.ndarray:
    """Extract the only robot's cells, cropped, from a world in EvoGym's format."""
    try:
        objects = read_objects(world).values()
    except WorldError as error:
        raise DesignError(f"{source} has no entry 'body' and is no world in EvoGym's format: {error}") from None
    robots = [one for one in objects if has_actuator(one.grid)]
    if len(robots) != 1:
        raise DesignError(f"{source} is a world with {len(robots)} robots; a design is a world with one.")
    grid = robots[0].grid
    connections = robots[0].connections
    cuts = len(full_connections(grid)) - len(np.unique(np.sort(connections, axis=0), axis=1).T)
    if cuts:
        raise DesignError(
            f"{source} leaves {cuts} pair(s) of neighbouring cells unconnected, which a design cannot say."
        )

    # Without empty rows and columns around it
    filled = grid != Cell.EMPTY
    rows = np.flatnonzero(filled.any(1))
    columns = np.flatnonzero(filled.any(0))
    return grid[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def _check_weights(weights: Sequence[float]) -> np.ndarray:
    """Return the sampling weights normalised, float ``[5]``; DesignError if they are not valid."""
    try:
        array = np.asarray(weights, dtype=float)
    except Exception:  # conversion of an arbitrary object may raise anything
        array = np.empty(0)
    if array.shape != (5,):
        raise DesignError(
            f"The probabilities must be five weights (empty, rigid, soft, horizontal, vertical), got {weights!r:.200}."
        )
    given = tuple(float(weight) for weight in array)
    total = array.sum()
    if not np.isfinite(total) or (array < 0).any():
        raise DesignError(f"The probabilities must be finite and not negative, got {given}.")
    if total == 0:
        raise DesignError(f"The probabilities are all zero: at least one weight must be positive, got {given}.")
    if (array[Cell.H_ACT] + array[Cell.V_ACT]) / total < 1e-6:  # hardly any body would have one
        raise DesignError(f"The probabilities must leave a chance for an actuator (the last two), got {given}.")
    return array / total


def _cell_names(robot_only: bool = False) -> str:
    names = [f"{int(cell)} {material.name}" for cell, material in MATERIALS.items()]
    if robot_only:
        names.remove(f"{int(Cell.FIXED)} fixed")
    return ", ".join(["0 empty", *names])


def _size(grid: np.ndarray) -> str:
    return "x".join(str(n) for n in grid.shape)


def _shorten(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."
