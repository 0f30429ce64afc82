"""Compilation of worlds into mass-spring models: points, springs, surface voxels and a lattice of static terrain.

Orders are part of the contract (observations and contacts depend on them): robots first, then the other objects,
each by name; inside an object points in the order in which its voxels, row by row from the top left, need them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from warpvox.contact_order import order_arrays
from warpvox.errors import SimulationError
from warpvox.types import ACTUATORS, VOXEL, Cell, Physics
from warpvox.world import World, WorldObject

# Corners and sides of a voxel in clockwise order; side k runs from corner k to corner k + 1.
TL, TR, BR, BL = range(4)
NOTHING_MOVES = "The world has nothing that can move: add a robot or an object with a cell that is not fixed."
TOP, RIGHT, BOTTOM, LEFT = 1, 2, 4, 8
"""Bits of the sides of a voxel."""

T = TypeVar("T")


@dataclass
class Body:
    """The mesh of one object; indices count from the object's own first point or spring.

    Equal objects share the lists, dictionaries and tables: they are not written to after the mesh is made.
    """

    name: str
    source: WorldObject
    points: list[tuple[float, float]] = field(default_factory=list)
    fixed: list[bool] = field(default_factory=list)
    corners: dict[tuple[int, int], list[int]] = field(default_factory=dict)  # (row, column) -> TL, TR, BR, BL
    sides: dict[tuple[int, int], list[int]] = field(default_factory=dict)  # (row, column) -> top, right, bottom, left
    surface: dict[tuple[int, int], int] = field(default_factory=dict)  # (row, column) -> bits, surface voxels only
    springs: list[list] = field(default_factory=list)  # [a, b, rest, stiffness]
    drives: dict[int, list[int]] = field(default_factory=dict)  # spring -> actions
    linked: dict[tuple[int, int], int] = field(default_factory=dict)  # (row, column) -> bits of connected neighbours
    tables: dict[Callable, Any] = field(default_factory=dict, repr=False, compare=False)  # see `table`
    first_point: int = 0
    first_action: int = 0
    loose: bool = False  # may begin an episode elsewhere

    @property
    def cells(self) -> list[tuple[int, int]]:
        """Non-empty cells as (row, column), row by row from the top left."""
        return list(self.corners)

    def kind(self, cell: tuple[int, int]) -> int:
        """Return the type of the cell at (row, column)."""
        return int(self.source.grid[cell])

    def table(self, make: Callable[[Body], T]) -> T:
        """Return ``make(self)``, cached and shared by equal objects; it must not depend on the place in the world."""
        if make not in self.tables:
            self.tables[make] = make(self)
        return self.tables[make]


@dataclass
class CompiledWorld:
    """A compiled world: meshes of movable objects, static terrain, and the size in cells."""

    bodies: list[Body]
    statics: list[Body]
    width: int
    height: int

    @property
    def robots(self) -> list[Body]:
        """Meshes of the robots."""
        return [body for body in self.bodies if body.source.is_robot]

    def body(self, name: str) -> Body | None:
        """Return the mesh of the object with this name, or None."""
        return next((body for body in self.bodies + self.statics if body.name == name), None)


def compile_world(world: World, physics: Physics, loose: Sequence[str] = ()) -> CompiledWorld:
    """Mesh every object of a world; objects named in ``loose`` become bodies even if all their cells are fixed.

    SimulationError: the world has no object that can move.
    """
    compiled = compile_objects(world.objects.values(), (world.width, world.height), physics, loose)
    if not compiled.bodies:
        raise SimulationError(NOTHING_MOVES)
    return compiled


def compile_objects(
    objects: Iterable[WorldObject], size: tuple[int, int], physics: Physics, loose: Sequence[str]
) -> CompiledWorld:
    """Mesh ``objects`` as :func:`compile_world` does, on a grid of ``size`` (columns, rows)."""
    ordered = sorted(objects, key=lambda o: (not o.is_robot, o.name))
    bodies = []
    statics = []
    point = action = 0
    for source in ordered:
        body = mesh(source, physics)
        is_loose = source.name in loose
        if source.is_static and not is_loose:
            statics.append(body)
            continue
        bodies.append(replace(body, first_point=point, first_action=action, loose=is_loose))
        point += len(body.points)
        action += source.num_actuators
    return CompiledWorld(bodies, statics, *size)


def mesh(source: WorldObject, physics: Physics) -> Body:
    """Return the mesh of one object: points, springs and surface (paper section A.1).

    The meshes of small objects that are not robots are cached: many worlds with the same terrain come one after the
    other.

    Those of small objects that are no robots are kept: many worlds with the same terrain come one after the other.
    """
    # A cell takes 2 kB.
    if source.is_robot or np.count_nonzero(source.grid) > 2_000:
        return _kept_mesh.__wrapped__(source, physics)
    return _kept_mesh(source, physics)


@functools.lru_cache(32)  # a benchmark task has at most 21 objects
def _kept_mesh(source: WorldObject, physics: Physics) -> Body:
    """Mesh one object; cached."""
    # The sides at which each filled cell is connected, row by row from the top left
    rows, columns = np.nonzero(source.grid)
    linked = dict.fromkeys(zip(rows.tolist(), columns.tolist(), strict=True), 0)
    for a, b in source.connections.tolist():
        first = divmod(a, source.width)
        second = divmod(b, source.width)
        below = second[0] > first[0]
        linked[first] |= BOTTOM if below else RIGHT
        linked[second] |= TOP if below else LEFT

    # Points and springs
    body = Body(source.name, source, linked=linked)
    for cell, bits in linked.items():
        _add_voxel(body, cell, bits, physics)

    # Surface sides run clockwise: the order of a point's forces depends on which end of a spring it is.
    for cell, bits in body.surface.items():
        for k, side in ((2, BOTTOM), (3, LEFT)):  # these were made the other way round
            if bits & side:
                spring = body.springs[body.sides[cell][k]]
                spring[0], spring[1] = spring[1], spring[0]

    kinds = source.grid.tolist()
    _set_stiffness(body, kinds, physics)

    # Actions drive top and bottom of a horizontal actuator, left and right of a vertical one.
    action = 0
    for (row, column), (top, right, bottom, left) in body.sides.items():
        kind = kinds[row][column]
        if kind in ACTUATORS:
            for s in (top, bottom) if kind == Cell.H_ACT else (left, right):
                body.drives.setdefault(s, []).append(action)
            action += 1

    # Fixed points
    for (row, column), corners in body.corners.items():
        if kinds[row][column] == Cell.FIXED:
            for p in corners:
                body.fixed[p] = True
    return body


def _add_voxel(body: Body, cell: tuple[int, int], bits: int, physics: Physics) -> None:
    """Add a cell's points and springs to the mesh, except those shared with connected cells added before."""
    row, column = cell
    above = body.corners[row - 1, column] if bits & TOP else None
    left = body.corners[row, column - 1] if bits & LEFT else None

    # Corners that connected cells above, to the left, or diagonally over one of both, have made. The last of them
    # counts: where connections are cut, they may have different points.
    top_left = top_right = bottom_left = None
    if above:
        top_left = above[BL]
        top_right = above[BR]
    if left:
        top_left = left[TR]
        bottom_left = left[BR]
    linked = body.linked
    if (above and linked[row - 1, column] & LEFT) or (left and linked[row, column - 1] & TOP):
        top_left = body.corners[row - 1, column - 1][BR]
    if (above and linked[row - 1, column] & RIGHT) or (bits & RIGHT and linked[row, column + 1] & TOP):
        top_right = body.corners[row - 1, column + 1][BL]

    # New points
    if top_left is None:
        top_left = _new_point(body, row, column)
    if top_right is None:
        top_right = _new_point(body, row, column + 1)
    if bottom_left is None:
        bottom_left = _new_point(body, row + 1, column)
    bottom_right = _new_point(body, row + 1, column + 1)
    body.corners[cell] = [top_left, top_right, bottom_right, bottom_left]

    # Sides: the lower one of the cell above, the right one of the cell to the left, else new springs
    springs = body.springs
    if above:
        top_side = body.sides[row - 1, column][2]
    else:
        top_side = len(springs)
        springs.append([top_left, top_right, VOXEL, physics.rigid_main])
    bottom_side = len(springs)
    springs.append([bottom_left, bottom_right, VOXEL, physics.rigid_main])
    if left:
        left_side = body.sides[row, column - 1][1]
    else:
        left_side = len(springs)
        springs.append([top_left, bottom_left, VOXEL, physics.rigid_main])
    right_side = len(springs)
    springs.append([top_right, bottom_right, VOXEL, physics.rigid_main])
    body.sides[cell] = [top_side, right_side, bottom_side, left_side]

    free_sides = (TOP | RIGHT | BOTTOM | LEFT) & ~bits
    if free_sides:
        body.surface[cell] = free_sides


def _new_point(body: Body, row: int, column: int) -> int:
    """Add a point at a grid node to the mesh; return its index."""
    # Exactly these expressions: the last bit of a coordinate decides which touching voxels are in contact.
    source = body.source
    x = source.x * VOXEL + column * VOXEL
    y = (source.y * VOXEL + source.height * VOXEL) - row * VOXEL
    body.points.append((x, y))
    body.fixed.append(False)
    return len(body.points) - 1


def _set_stiffness(body: Body, kinds: list[list[int]], physics: Physics) -> None:
    """Set the stiffness of sides by the preset's rule, and add two diagonal springs for each voxel."""
    diagonal = (VOXEL * VOXEL + VOXEL * VOXEL) ** 0.5
    by_kind = {int(kind): physics.stiffness(kind) for kind in Cell}
    stiffest: dict[int, float] = {}
    for (row, column), corners in body.corners.items():
        kind = kinds[row][column]
        main, structural = by_kind[kind]
        for s in body.sides[row, column]:
            if physics.shared_edge == "stiffest":
                stiffest[s] = max(stiffest.get(s, 0.0), main)
                body.springs[s][3] = stiffest[s]
            elif kind not in (Cell.RIGID, Cell.FIXED):
                body.springs[s][3] = main
        body.springs.append([corners[TR], corners[BL], diagonal, structural])
        body.springs.append([corners[TL], corners[BR], diagonal, structural])


def exact_tables(designs: list[CompiledWorld], lanes: int) -> dict[str, np.ndarray]:
    """Make the tables of packs for exact arithmetic; all lanes of a pack hold the same world.

    Points and springs stand in the order in which the released simulator makes them.
    """
    tables = [_exact_table(design, lanes) for design in designs]
    return join([{name: values[None] for name, values in table.items()} for table in tables])


def _exact_table(design: CompiledWorld, lanes: int) -> dict[str, np.ndarray]:
    """Make the table of one pack whose lanes all hold one world."""
    out = world_arrays(design)
    points = len(out["fixed"])

    # Masks: all lanes hold the world
    sides = out.pop("side")[:, None] >> np.arange(4) & 1
    out["side_lanes"] = (-sides).astype(np.int32)
    out["free_lanes"] = np.where(out.pop("fixed") == 0, -1, 0).astype(np.int32)
    out["spring_lanes"] = np.full(len(out["spring_rest"]), -1, np.int32)
    out["rigid_lanes"] = np.full(len(out["rigid_spring"]), -1, np.int32)
    out["stiffness"] = out["spring_k"]
    out["alike"] = np.asarray(1, np.int32)

    # A column for each lane
    out["spring_drive"] = pack_drives(out["spring_drive"], axis=1)
    out["order"] = np.arange(points, dtype=np.int32)
    out["object_points"] = np.array([len(body.points) for body in design.bodies], np.int32)
    for name in ("rest_pos", "spring_k", "spring_drive", "fold_limit", "order", "object_points"):
        out[name] = np.repeat(out[name][:, None], lanes, axis=1)

    # Tables of the fast arithmetic alone
    empty = {
        "twin_range": (points, 2), "twin": (0, 2), "twin_lanes": (0,), "twin_end": (0, 4),
        "last_spring": (int(out["actives"]),), "twins": (), "twin_ends": (), "first_other": (),
    }  # fmt: skip
    for name, shape in empty.items():
        out[name] = np.zeros(shape, np.int32)
    return out | order_arrays(design)


def pack_drives(drives: np.ndarray, axis: int) -> np.ndarray:
    """Pack two actuator indices into one int32: each plus 1, the first in the low 16 bits.

    Entries are the actions that drive a spring, -1 for none.
    """
    one = np.take(drives, 0, axis=axis) + 1
    two = np.take(drives, 1, axis=axis) + 1
    return (one | two << 16).astype(np.int32)


def join(parts: Sequence[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Concatenate lists of tables, padded to the largest size of each axis.

    The padding is 0, or -1 in tables where 0 is an index.
    """
    if len(parts) == 1:
        return parts[0]
    joined = {}
    for name in parts[0]:
        tables = [part[name] for part in parts]
        shape = np.max([table.shape[1:] for table in tables], axis=0).astype(int)
        fill = -1 if name in ("pushed", "fixed_at", "order") else 0
        whole = np.full((sum(map(len, tables)), *shape), fill, tables[0].dtype)
        begin = 0
        for table in tables:
            end = begin + len(table)
            place = (slice(begin, end), *(slice(size) for size in table.shape[1:]))
            whole[place] = table
            begin = end
        joined[name] = whole
    return joined


def world_arrays(design: CompiledWorld) -> dict[str, np.ndarray]:
    """Return a compiled world as arrays, with the names of :data:`warpvox.kernels.state.MODEL`."""
    # Tables of the objects, one behind the other. Numbers of points, springs and actions count on.
    no_object = {
        "fixed": np.zeros(0, np.int32),
        "rest_pos": np.zeros(0),
        "spring_ends": np.zeros((0, 2), np.int32),
        "spring_rest": np.zeros(0),
        "spring_k": np.zeros(0),
        "spring_drive": np.zeros((0, 2), np.int32),
        "rigid_spring": np.zeros(0, np.int32),
        "corner": np.zeros((0, 4), np.int32),
        "side": np.zeros(0, np.int32),
        "body": np.zeros(0, np.int32),
        "robot": np.zeros(0, np.int32),
        "grid": np.zeros((0, 2), np.int32),
    }
    parts = {name: [values] for name, values in no_object.items()}
    springs = 0
    for number, body in enumerate(design.bodies):
        own = body.table(_body_arrays)
        drives = own["spring_drive"]
        voxels = np.full(len(own["side"]), number, np.int32)
        placed = {
            "spring_ends": own["spring_ends"] + body.first_point,
            "spring_drive": np.where(drives >= 0, drives + body.first_action, -1),
            "rigid_spring": own["rigid_spring"] + springs,
            "corner": own["corner"] + body.first_point,
            "body": voxels,
            "robot": voxels if body.source.is_robot else np.full_like(voxels, -1),  # robots come first
        }
        for name, values in (own | placed).items():
            parts[name].append(values)
        springs += len(drives)
    out: dict[str, Any] = {name: np.concatenate(values) for name, values in parts.items()}

    # Points that are free or hang on a spring
    ends = out["spring_ends"].ravel()
    active = out["fixed"] == 0
    active[ends] = True
    points = np.flatnonzero(active)
    out["active"] = np.stack([2 * points, 2 * points + 1], axis=1).ravel()

    # Springs point by point: s at the first end of spring s, then -1 - s at the second, each in ascending order
    entry = np.arange(len(ends))
    order = np.lexsort((entry, entry % 2, ends))
    out["link"] = np.where(order % 2 == 0, order // 2, -1 - order // 2)
    out["link_start"] = np.concatenate([[0], np.cumsum(np.bincount(ends, minlength=len(active)))])

    # Surface voxels
    out["pushed"] = np.where(active[out["corner"]], out["corner"], -1)
    out["fixed_voxel"] = out["pushed"].max(axis=1) < 0
    movable = np.ones(len(out["side"]), bool)

    # For every cell of the terrain the surface voxel that always stays there, or -1
    fixed_at = np.full(design.width * design.height, -1)
    for number, body in enumerate(design.bodies):
        if not body.loose:
            voxels = np.flatnonzero(out["fixed_voxel"] & (out["body"] == number))
            fixed_at[_lattice_cells(design, body.source, out["grid"][voxels])] = voxels
    movable[fixed_at[fixed_at >= 0]] = False
    out["fixed_at"] = fixed_at
    out["movable"] = np.flatnonzero(movable)
    out["fold_limit"] = [len(body.surface) for body in design.robots]

    # Sizes
    out["points"] = len(active)
    out["actives"] = len(points)
    out["springs"] = springs
    out["rigids"] = len(out["rigid_spring"])
    out["voxels"] = len(movable)
    out["movables"] = np.count_nonzero(movable)
    out["robots"] = len(design.robots)
    out["actions"] = sum(body.source.num_actuators for body in design.bodies)

    # Surface bits and bounds of the static cells, on the world's grid with row 0 at the bottom
    terrain_side = np.zeros(design.width * design.height, np.int32)
    terrain_box = np.zeros((design.width * design.height, 4))
    for body in design.statics:
        cells, bits, bounds = body.table(_static_cells)
        at = _lattice_cells(design, body.source, cells)
        terrain_side[at] = bits
        terrain_box[at] = bounds
    out["terrain"] = [design.width, design.height]
    out["terrain_side"] = terrain_side

    # All are integers but these.
    reals = {name: out.pop(name) for name in ("rest_pos", "spring_rest", "spring_k")}
    reals["terrain_box"] = terrain_box
    return {name: np.asarray(values, np.int32) for name, values in out.items()} | reals


def _body_arrays(body: Body) -> dict[str, np.ndarray]:
    """Return the points, springs and surface voxels of one object as arrays; indices begin at 0."""
    # Springs, without those that are always at rest: they give no force and have no strain
    place = {}
    ends = []
    rests = []
    stiffness = []
    drives = []
    for s, (a, b, rest, k) in enumerate(body.springs):
        if body.fixed[a] and body.fixed[b] and s not in body.drives:
            continue
        place[s] = len(ends)
        ends.append((a, b))
        rests.append(rest)
        stiffness.append(k)
        drives.append([*body.drives.get(s, ()), -1, -1][:2])
    kinds = body.source.grid.tolist()
    rigid = []
    for (row, column), sides in body.sides.items():
        if kinds[row][column] == Cell.RIGID:
            rigid += [place[s] for s in sides if s in place]

    return {
        "fixed": np.array(body.fixed, np.int32),
        "rest_pos": np.array(body.points, np.float64).ravel(),
        "spring_ends": np.array(ends, np.int32).reshape(-1, 2),
        "spring_rest": np.array(rests, np.float64),
        "spring_k": np.array(stiffness, np.float64),
        "spring_drive": np.array(drives, np.int32).reshape(-1, 2),
        "rigid_spring": np.array(rigid, np.int32),
        "corner": np.array([body.corners[cell] for cell in body.surface], np.int32).reshape(-1, 4),
        "side": np.array(list(body.surface.values()), np.int32),
        "grid": np.array(list(body.surface), np.int32).reshape(-1, 2)[:, ::-1],  # column and row
    }


def _static_cells(body: Body) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return an object's cells (column, row), their surface bits and their bounds (left, right, bottom, top)."""
    cells = np.array(body.cells)[:, ::-1]
    bits = [body.surface.get(cell, 0) for cell in body.corners]
    points = np.array(body.points)
    corners = np.array(list(body.corners.values()))
    left_top = points[corners[:, TL]]
    right_bottom = points[corners[:, BR]]
    bounds = np.stack([left_top[:, 0], right_bottom[:, 0], right_bottom[:, 1], left_top[:, 1]], axis=1)
    return cells, np.array(bits, np.int32), bounds


def _lattice_cells(design: CompiledWorld, source: WorldObject, cells: np.ndarray) -> np.ndarray:
    """Convert an object's cells ``[n, 2]`` (column, row) to indices in the world's lattice."""
    return (source.y + source.height - 1 - cells[:, 1]) * design.width + source.x + cells[:, 0]
