"""Terrain from text and run-length data, and the world of a task with its robots.

Cells are written ``.`` empty, ``R`` rigid, ``S`` soft, ``H`` and ``V`` actuators, ``F`` fixed. A *line* is a
list of runs: ``"20. 10F"`` is twenty empty cells and ten fixed ones, a run of one cell needs no number.
"""

import re
from collections.abc import Sequence
from itertools import zip_longest
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from warpvox.checks import design_of, is_list, is_mapping
from warpvox.design import Design, load_design
from warpvox.envs.spec import ROBOT, TaskSpec
from warpvox.errors import ConfigError, DesignError, WorldError, did_you_mean, listing
from warpvox.examples import design_for
from warpvox.types import EMPTY_LETTER, MATERIALS, Cell
from warpvox.world import World, WorldObject

_CELLS = {EMPTY_LETTER: Cell.EMPTY} | {material.letter: cell for cell, material in MATERIALS.items()}


def block(name: str, width: int, height: int, cell: str = "F", x: int = 0, y: int = 0) -> WorldObject:
    """Create a solid rectangle of one cell type with its lower left corner at cell (x, y)."""
    return WorldObject.from_array(name, np.full((height, width), int(_CELLS[cell]), np.int8), x, y)


def rows(name: str, *lines: str, x: int = 0, y: int = 0) -> WorldObject:
    """Create an object from rows of cells, the bottom row first; short rows end with empty cells."""
    return WorldObject.from_array(name, _stack(lines)[::-1], x, y)


def columns(name: str, *lines: str, x: int = 0, y: int = 0) -> WorldObject:
    """Create an object from columns of cells, the leftmost first, bottom up; short columns end with empty cells."""
    return WorldObject.from_array(name, _stack(lines).T[::-1], x, y)


def heights(name: str, profile: str, cell: str = "F", x: int = 0, y: int = 0) -> WorldObject:
    """Create solid columns from y upward with heights in runs ``HEIGHTxCOUNT``: ``"1x22 2 1x5"``."""
    lines: list[str] = []
    for run in profile.split():
        height, _, count = run.partition("x")
        lines += [f"{height}{cell}"] * int(count or 1)
    return columns(name, *lines, x=x, y=y)


def task_team(task: TaskSpec, design: object) -> dict[str, object]:
    """Return the body of every robot of a task, ``{name: body}``, the robot named ``robot`` first.

    Args:
        design: such a mapping, or one body, which all robots of the task then have.

    Raises:
        DesignError: the mapping lacks a robot of the task, or names one that it has not.
    """
    if not is_mapping(design):
        return dict.fromkeys(task.robots, design)
    for name in design:
        if name not in task.robots:
            hint = did_you_mean(name, task.robots)
            raise DesignError(f"{task.id} has the robots {listing(task.robots)}, not {name!r}.{hint}")
    missing = [name for name in task.robots if name not in design]
    if missing:
        raise DesignError(f"The design for {task.id} names no body for {listing(missing)}.")
    return {name: design[name] for name in task.robots}


def task_world(task: TaskSpec, body: object, connections: object = None) -> World:
    """Build the world of a task with its robots in place.

    Args:
        body: valid design, int8 ``[rows, columns]``, or such bodies by the names of the task's robots.
        connections: EvoGym's ``[2, k]`` pairs of flat cell indices, or those by the names of robots; None connects
            all neighbours.

    Raises:
        WorldError: a body does not fit, or the connections are not between neighbouring cells.
    """
    world = World()
    for obj in task.objects:
        world.add_object(obj)
    end = world.width if any(obj.is_static for obj in task.objects) else inf
    links = connections if is_mapping(connections) else {ROBOT: connections}
    for name, cells in task_team(task, body).items():
        try:
            robot = world.add_from_array(name, cells, *task.robots[name], connections=links.get(name))
            if robot.x + robot.width > end:
                raise WorldError(f"from column {robot.x} it reaches beyond the last one, {end - 1}.")
        except WorldError as error:
            shape = "x".join(str(n) for n in np.asarray(cells).shape)
            raise WorldError(f"The {shape} body does not fit the world of {task.id}: {error}") from None
    return world


def _stack(lines: Sequence[str]) -> np.ndarray:
    """Convert lines of text to cells, int8 ``[lines, cells]``, padded with empty cells."""
    run = rf"(\d*)([{''.join(_CELLS)}])"
    parsed: list[list[int]] = []
    for line in lines:
        packed = line.replace(" ", "")
        if re.sub(run, "", packed):
            raise WorldError(f"Cannot read the terrain line {line!r}: expected runs such as '20. 10F'.")
        cells: list[int] = []
        for count, letter in re.findall(run, packed):
            cells += [_CELLS[letter]] * int(count or 1)
        parsed.append(cells)
    return np.array(list(zip_longest(*parsed, fillvalue=Cell.EMPTY)), np.int8).T


def one_body(body: object, designs: Any, connections: Any) -> tuple[Any, Any]:
    """Return ``designs`` and ``connections``, made from ``body`` if given; ConfigError: both are given."""
    if body is None:
        return designs, connections
    if designs is not None:
        raise ConfigError("Give one body for all environments (body=...) or a list of them (designs=[...]), not both.")
    return [body], None if connections is None else [connections]


def load_worlds(spec: TaskSpec, designs: Any, connections: Any) -> tuple[list[Design | dict[str, Design]], list[World]]:
    """Load and check the bodies (of several robots by name); return the bodies and a world for each.

    Raises:
        DesignError, WorldError: a body that is not valid, or does not fit. ConfigError: not a connection for each.
    """
    if designs is None:
        designs = ["walker"]
    designs = str(designs) if isinstance(designs, Path) else design_of(designs)

    # One body: a name, robots by name, an array of two dimensions, or a list of rows, which are lists that hold none
    is_array = getattr(designs, "ndim", 1) in (0, 2)
    if not is_array and is_list(designs) and len(designs):
        is_array = all(is_list(row) and not isinstance(row, str) and not any(map(is_list, row)) for row in designs)
    single = is_array or isinstance(designs, str) or is_mapping(designs)
    if not single and not is_list(designs):
        raise DesignError(f"designs must be a list of bodies, got {type(designs).__name__}.")
    bodies: list[object] = [designs] if single else [design_of(body) for body in designs]
    if not bodies:
        raise DesignError("The list of designs is empty: at least one body is needed.")

    # Valid bodies
    loaded: list[Design | dict[str, Design]] = []
    for number, body in enumerate(bodies):
        try:
            team = {name: load_design(given) for name, given in task_team(spec, design_for(spec.id, body)).items()}
        except DesignError as error:
            raise DesignError(f"Design {number}: {error}" if len(bodies) > 1 else str(error)) from None
        loaded.append(team if spec.partners else team[ROBOT])

    # Their worlds
    links = [None] * len(loaded) if connections is None else connections
    if not is_list(links) or len(links) != len(loaded):
        got = len(links) if is_list(links) else type(links).__name__
        raise ConfigError(f"connections must be a list with one entry a design ({len(loaded)}), got {got}.")
    return loaded, [task_world(spec, body, link) for body, link in zip(loaded, links, strict=True)]
