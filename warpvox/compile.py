"""From worlds to a Model: points, springs, surface voxels and a lattice of static terrain.

Orders are part of the contract (observations and contacts depend on them): robots first, then the other objects,
each by name; inside an object points in the order in which its voxels, row by row from the top left, need them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from warpvox.contact_order import order_arrays
from warpvox.errors import SimulationError
from warpvox.types import VOXEL, Cell, Physics
from warpvox.world import World, WorldObject

# Corners and sides of a voxel in clockwise order; side k runs from corner k to corner k + 1.
TL, TR, BR, BL = range(4)
CREATION = (TL, TR, BL, BR)
SIDE_ENDS = ((TL, TR), (BL, BR), (TL, BL), (TR, BR))  # top, bottom, left, right: the order in which sides are made
FILL = {"pushed": -1, "fixed_at": -1, "order": -1}
"""Padding of tables, if not 0."""
NOTHING_MOVES = "The world has nothing that can move: add a robot or an object with a cell that is not fixed."
SIDE_BIT = {"top": 1, "right": 2, "bottom": 4, "left": 8}


@dataclass
class Body:
    """One object as a mesh. Index arrays count from the object's own first point or spring."""

    name: str
    source: WorldObject
    points: list[tuple[float, float]] = field(default_factory=list)
    fixed: list[bool] = field(default_factory=list)
    corners: dict[tuple[int, int], list[int]] = field(default_factory=dict)  # (row, column) -> TL, TR, BR, BL
    sides: dict[tuple[int, int], list[int]] = field(default_factory=dict)  # (row, column) -> top, right, bottom, left
    surface: dict[tuple[int, int], int] = field(default_factory=dict)  # (row, column) -> bits, surface voxels only
    springs: list[list] = field(default_factory=list)  # [a, b, rest, stiffness]
    drives: dict[int, list[int]] = field(default_factory=dict)  # spring -> actions
    links: set = field(default_factory=set)  # connected neighbours, both ways, as pairs of (row, column)
    first_point: int = 0
    first_action: int = 0
    loose: bool = False  # may begin an episode elsewhere

    @property
    def cells(self) -> list[tuple[int, int]]:
        """Cells that are not empty, row by row from the top left."""
        return list(self.corners)

    def kind(self, cell: tuple[int, int]) -> int:
        """Type of a cell."""
        return int(self.source.grid[cell])


@dataclass
class CompiledWorld:
    """A compiled world: its bodies (objects with a cell that can move), its static terrain, and its size in cells."""

    bodies: list[Body]
    statics: list[Body]
    width: int
    height: int

    @property
    def robots(self) -> list[Body]:
        return [body for body in self.bodies if body.source.is_robot]

    def body(self, name: str) -> Body | None:
        """The mesh of an object, or None."""
        return next((body for body in self.bodies + self.statics if body.name == name), None)


def compile_world(world: World, physics: Physics, loose: Sequence[str] = ()) -> CompiledWorld:
    """Mesh every object of a world; those named in ``loose`` become bodies even if none of their cells can move.

    SimulationError: the world has no object that can move.
    """
    compiled = compile_objects(world.objects.values(), (world.width, world.height), physics, loose)
    if not compiled.bodies:
        raise SimulationError(NOTHING_MOVES)
    return compiled


def compile_objects(
    objects: Iterable[WorldObject], size: tuple[int, int], physics: Physics, loose: Sequence[str]
) -> CompiledWorld:
    """The same of some objects, on a grid of ``size`` (columns, rows); there may be nothing that moves."""
    ordered = sorted(objects, key=lambda o: (not o.is_robot, o.name))
    terrain = {o.name for o in ordered if o.is_static and o.name not in loose}
    bodies = [mesh(o, physics) for o in ordered if o.name not in terrain]
    point = action = 0
    for body in bodies:
        body.loose = body.name in loose
        body.first_point, body.first_action = point, action
        point += len(body.points)
        action += body.source.num_actuators
    return CompiledWorld(bodies, [mesh(o, physics) for o in ordered if o.name in terrain], *size)


def mesh(source: WorldObject, physics: Physics) -> Body:
    """Points, springs and surface of one object (paper section A.1)."""
    body = Body(source.name, source, links=_links(source))
    for row, column in np.argwhere(source.grid).tolist():
        _add_voxel(body, (row, column), physics)
    _orient_surface(body)
    _set_stiffness(body, physics)
    _set_drives(body)
    for cell, corners in body.corners.items():
        if body.kind(cell) == Cell.FIXED:
            for p in corners:
                body.fixed[p] = True
    return body


def _links(source: WorldObject) -> set[tuple[tuple[int, int], tuple[int, int]]]:
    """Connected neighbours, both ways, as pairs of (row, column)."""
    columns = source.width
    pairs = set()
    for a, b in source.connections.tolist():
        ca, cb = divmod(a, columns), divmod(b, columns)
        pairs.update({(ca, cb), (cb, ca)})
    return pairs


def _add_voxel(body: Body, cell: tuple[int, int], physics: Physics) -> None:
    row, column = cell
    near = {
        "top": (row - 1, column),
        "bottom": (row + 1, column),
        "left": (row, column - 1),
        "right": (row, column + 1),
    }
    linked = {side: (cell, other) in body.links for side, other in near.items()}
    corners = {}
    for corner in CREATION:
        found = _find_corner(body, cell, corner)
        if found is None:
            found = _new_point(body, row + (corner in (BL, BR)), column + (corner in (TR, BR)))
        corners[corner] = found
    body.corners[cell] = [corners[c] for c in range(4)]
    top = body.sides[near["top"]][2] if linked["top"] else None
    left = body.sides[near["left"]][1] if linked["left"] else None
    made = []
    for side, (a, b) in zip((top, None, left, None), SIDE_ENDS, strict=True):
        made.append(len(body.springs) if side is None else side)
        if side is None:
            body.springs.append([corners[a], corners[b], VOXEL, physics.rigid_main])
    body.sides[cell] = [made[0], made[3], made[1], made[2]]
    bits = sum(SIDE_BIT[side] for side in near if not linked[side])
    if bits:
        body.surface[cell] = bits


def _orient_surface(body: Body) -> None:
    """Surface sides run clockwise: the order of a point's forces depends on which end of a spring it is."""
    for cell, bits in body.surface.items():
        for k in (2, 3):  # bottom and left were made the other way round
            if bits >> k & 1:
                spring = body.springs[body.sides[cell][k]]
                spring[0], spring[1] = spring[1], spring[0]


def _find_corner(body: Body, cell: tuple[int, int], corner: int) -> int | None:
    """The point that a connected voxel above or to the left has made at this corner; the last candidate counts."""
    (row, column), links = cell, body.links
    up, side = (-1 if corner in (TL, TR) else 1), (-1 if corner in (TL, BL) else 1)
    vertical, horizontal, diagonal = (row + up, column), (row, column + side), (row + up, column + side)
    mirror_v = {TL: BL, TR: BR, BL: TL, BR: TR}[corner]
    mirror_h = {TL: TR, TR: TL, BL: BR, BR: BL}[corner]
    mirror_d = {TL: BR, TR: BL, BL: TR, BR: TL}[corner]
    by_vertical, by_horizontal = (cell, vertical) in links, (cell, horizontal) in links
    found = None
    if by_vertical and vertical in body.corners:
        found = body.corners[vertical][mirror_v]
    if by_horizontal and horizontal in body.corners:
        found = body.corners[horizontal][mirror_h]
    around = (by_vertical and (vertical, diagonal) in links) or (by_horizontal and (horizontal, diagonal) in links)
    if around and diagonal in body.corners:
        found = body.corners[diagonal][mirror_d]
    return found


def _new_point(body: Body, row: int, column: int) -> int:
    # Exactly these expressions: the last bit of a coordinate decides which touching voxels are in contact.
    source = body.source
    x = source.x * VOXEL + column * VOXEL
    y = (source.y * VOXEL + source.height * VOXEL) - row * VOXEL
    body.points.append((x, y))
    body.fixed.append(False)
    return len(body.points) - 1


def _set_stiffness(body: Body, physics: Physics) -> None:
    """Stiffness of the sides by the preset's rule for shared ones; two diagonals a voxel."""
    diagonal = (VOXEL * VOXEL + VOXEL * VOXEL) ** 0.5
    stiffest: dict[int, float] = {}
    for cell, corners in body.corners.items():
        kind = body.kind(cell)
        main, structural = physics.stiffness(kind)
        for s in body.sides[cell]:
            if physics.shared_edge == "stiffest":
                stiffest[s] = max(stiffest.get(s, 0.0), main)
                body.springs[s][3] = stiffest[s]
            elif kind not in (Cell.RIGID, Cell.FIXED):
                body.springs[s][3] = main
        body.springs.append([corners[TR], corners[BL], diagonal, structural])
        body.springs.append([corners[TL], corners[BR], diagonal, structural])


def _set_drives(body: Body) -> None:
    """Which actions drive which sides: top and bottom of a horizontal actuator, left and right of a vertical one."""
    action = 0
    for cell in body.cells:
        kind = body.kind(cell)
        if kind in (Cell.H_ACT, Cell.V_ACT):
            top, right, bottom, left = body.sides[cell]
            for s in (top, bottom) if kind == Cell.H_ACT else (left, right):
                body.drives.setdefault(s, []).append(action)
            action += 1


def exact_tables(designs: list[CompiledWorld], lanes: int) -> dict[str, np.ndarray]:
    """The tables of packs whose lanes all hold one world, for the exact arithmetic: an entry for each world.

    Points and springs stand in the order in which the released simulator makes them.
    """
    tables = [_exact_table(design, lanes) for design in designs]
    return join([{name: values[None] for name, values in table.items()} for table in tables])


def _exact_table(design: CompiledWorld, lanes: int) -> dict[str, np.ndarray]:
    out = world_arrays(design)
    tree = order_arrays(design)
    points, springs = len(out["fixed"]), len(out["spring_rest"])

    out["stiffness"] = out["spring_k"]
    out["last_spring"] = np.zeros(int(out["actives"]), np.int32)

    def in_lanes(values: np.ndarray) -> np.ndarray:
        return np.repeat(values[:, None], lanes, axis=1)

    bits = out.pop("side")[:, None] >> np.arange(4) & 1
    out |= dict(
        free_lanes=np.where(out.pop("fixed") == 0, -1, 0).astype(np.int32),
        spring_lanes=np.full(springs, -1, np.int32),
        rigid_lanes=np.full(len(out["rigid_spring"]), -1, np.int32),
        side_lanes=(-bits).astype(np.int32),
        rest_pos=in_lanes(out["rest_pos"]),
        spring_k=in_lanes(out["spring_k"]),
        spring_drive=in_lanes(pack_drives(out["spring_drive"], axis=1)),
        fold_limit=in_lanes(out["fold_limit"]),
        order=in_lanes(np.arange(points, dtype=np.int32)),
        object_points=in_lanes(np.array([len(body.points) for body in design.bodies], np.int32)),
        twin_range=np.zeros((points, 2), np.int32),
        twin=np.zeros((0, 2), np.int32),
        twin_lanes=np.zeros(0, np.int32),
        twin_end=np.zeros((0, 4), np.int32),
    )
    scalars = dict(twins=0, twin_ends=0, alike=1, first_other=0, actions=int(out["actions"]))
    return out | tree | {name: np.asarray(value, np.int32) for name, value in scalars.items()}


def pack_drives(drives: np.ndarray, axis: int) -> np.ndarray:
    """int32: the one or two actions (-1: none) along an axis in one number each, plus one, low half first."""
    one, two = np.take(drives, 0, axis=axis) + 1, np.take(drives, 1, axis=axis) + 1
    return (one | two << 16).astype(np.int32)


def join(parts: Sequence[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Tables of several lists of packs as one, padded to common capacities."""
    if len(parts) == 1:
        return parts[0]
    return {name: _join([part[name] for part in parts], FILL.get(name, 0)) for name in parts[0]}


def _join(values: list[np.ndarray], fill: int) -> np.ndarray:
    shape = np.max([value.shape[1:] for value in values], axis=0).astype(int)
    whole = np.full((sum(map(len, values)), *shape), fill, values[0].dtype)
    begin = 0
    for value in values:
        whole[(slice(begin, begin + len(value)), *(slice(n) for n in value.shape[1:]))] = value
        begin += len(value)
    return whole


def world_arrays(design: CompiledWorld) -> dict[str, np.ndarray]:
    """Arrays of one compiled world, named as in :data:`warpvox.kernels.state.MODEL` where they mean the same."""
    bodies = design.bodies
    ends, rests, stiffness, drives, rigid, corner, side, owner, robot, grid = ([] for _ in range(10))
    robots = design.robots
    for index, body in enumerate(bodies):
        base = body.first_point
        place = {}
        for s, (a, b, rest, k) in enumerate(body.springs):
            if body.fixed[a] and body.fixed[b] and s not in body.drives:
                continue  # always at rest: no force, no strain
            place[s] = len(ends)
            ends.append([a + base, b + base])
            rests.append(rest)
            stiffness.append(k)
            actions = [action + body.first_action for action in body.drives.get(s, ())] + [-1, -1]
            drives.append(actions[:2])
        for cell in body.cells:
            if body.kind(cell) == Cell.RIGID:
                rigid += [place[s] for s in body.sides[cell] if s in place]
        for cell, bits in body.surface.items():
            corner.append([p + base for p in body.corners[cell]])
            side.append(bits)
            owner.append(index)
            robot.append(index if body.source.is_robot else -1)  # robots come first
            grid.append([cell[1], cell[0]])
    rest_pos = [value for body in bodies for point in body.points for value in point]
    lattice = _lattice(design)
    fixed = [f for body in bodies for f in body.fixed]
    tied = {p for pair in ends for p in pair}
    active = [p for p, is_fixed in enumerate(fixed) if not is_fixed or p in tied]
    pushed = np.reshape(np.where(np.isin(corner, active), corner, -1), (-1, 4))
    fixed_voxel = pushed.max(axis=1) < 0
    fixed_at = _fixed_voxels(design, fixed_voxel, owner, grid)
    whole = dict(
        points=len(fixed),
        actives=len(active),
        springs=len(ends),
        rigids=len(rigid),
        voxels=len(side),
        movables=len(side) - np.count_nonzero(fixed_at >= 0),
        robots=len(robots),
        actions=sum(body.source.num_actuators for body in bodies),
    )
    arrays = dict(
        fixed=fixed,
        active=[r for p in active for r in (2 * p, 2 * p + 1)],
        spring_ends=np.reshape(ends, (-1, 2)),
        spring_drive=np.reshape(drives, (-1, 2)),
        link_start=np.concatenate([[0], np.cumsum(np.bincount(np.array(ends, int).ravel(), minlength=len(fixed)))]),
        link=_links_of_points(ends),
        rigid_spring=rigid,
        corner=np.reshape(corner, (-1, 4)),
        pushed=pushed,
        side=side,
        body=owner,
        robot=robot,
        grid=np.reshape(grid, (-1, 2)),
        fixed_voxel=fixed_voxel,
        movable=np.setdiff1d(np.arange(len(fixed_voxel)), fixed_at),
        fixed_at=fixed_at,
        fold_limit=[len(body.surface) for body in robots],
    )
    reals = dict(rest_pos=rest_pos, spring_rest=rests, spring_k=stiffness, terrain_box=lattice[1])
    out = {name: np.asarray(value, dtype=np.int32) for name, value in (whole | arrays).items()}
    out |= {name: np.asarray(value, dtype=np.float64) for name, value in reals.items()}
    out["terrain"] = np.array([design.width, design.height], dtype=np.int32)
    out["terrain_side"] = lattice[0]
    return out


def _links_of_points(ends: list[list[int]]) -> np.ndarray:
    """Springs point by point: s at the first end of spring s, then -1 - s at the second, each in ascending order."""
    point = np.array(ends, int).ravel()
    order = np.lexsort((np.arange(len(point)), np.arange(len(point)) % 2, point))
    return np.where(order % 2 == 0, order // 2, -1 - order // 2)


def _fixed_voxels(design: CompiledWorld, fixed: np.ndarray, owner: list[int], grid: list[list[int]]) -> np.ndarray:
    """For every cell of the terrain lattice the surface voxel that always stays there, or -1."""
    width, height = design.width, design.height
    at = np.full(width * height, -1)
    for v, (column, row) in enumerate(grid):
        body = design.bodies[owner[v]]
        if fixed[v] and not body.loose:
            source = body.source
            at[(source.y + source.height - 1 - row) * width + source.x + column] = v
    return at


def _lattice(design: CompiledWorld) -> tuple[np.ndarray, np.ndarray]:
    """Surface bits and bounds of the static cells, on the world's grid with row 0 at the bottom."""
    width, height = design.width, design.height
    bits = np.zeros(width * height, dtype=np.int32)
    bounds = np.zeros((width * height, 4))
    for body in design.statics:
        source = body.source
        for (row, column), corners in body.corners.items():
            at = (source.y + source.height - 1 - row) * width + source.x + column
            left, top = body.points[corners[TL]]
            right, bottom = body.points[corners[BR]]
            bounds[at] = left, right, bottom, top
            bits[at] = body.surface.get((row, column), 0)
    return bits, bounds
