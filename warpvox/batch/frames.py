"""Tables of packs whose lanes hold different bodies, for the fast arithmetic.

Worlds that differ in nothing but the cells of their robots have one *frame*: terrain, other objects and where the
robots begin. Environments of one frame share packs, whatever their bodies; :mod:`warpvox.batch.grid_mesh` says how.
Tables number what some lane of a pack has: robots by name, then the other objects by name, each in the order of its
grid.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpvox.batch.grid_mesh import TWIN_PAIRS, GridMesh, RobotBodies, most_points, pack_bits
from warpvox.compile import NOTHING_MOVES, compile_objects, join, pack_drives, world_arrays
from warpvox.errors import SimulationError
from warpvox.types import Physics
from warpvox.world import World, WorldObject

CHUNK = 1_000_000  # entries of the largest array that is made at once: it stays in the cache


def frame_key(world: World) -> tuple:
    """Equal exactly for worlds of one frame."""
    objects = sorted(world.objects.values(), key=lambda obj: obj.name)
    robots = tuple((obj.name, obj.x, obj.y) for obj in objects if obj.is_robot)
    return robots, tuple(obj.key() for obj in objects if not obj.is_robot)


def is_cut(obj: WorldObject) -> bool:
    """Whether some neighbouring cells of an object are not connected."""
    filled = obj.grid != 0
    beside = np.count_nonzero(filled[:, 1:] & filled[:, :-1]) + np.count_nonzero(filled[1:] & filled[:-1])
    return beside != len(obj.connections)


class Frame:
    """The common part of the worlds of a batch of packs, and the tables of such packs.

    Args:
        worlds: all of one frame.
        physics: its stiffnesses go into the tables.
        loose: see :class:`warpvox.Simulation`.
        grid: rows and columns that robots may have at least.
    """

    def __init__(
        self, worlds: Sequence[World], physics: Physics, loose: Sequence[str], grid: tuple[int, int] = (1, 1)
    ) -> None:
        first = worlds[0]
        self.physics = physics
        self.names = sorted(name for name, obj in first.objects.items() if obj.is_robot)
        self.places = [(first.objects[name].x, first.objects[name].y) for name in self.names]
        self.bodies = [RobotBodies.of([world.objects[name] for world in worlds], grid) for name in self.names]
        size = max(world.width for world in worlds), max(world.height for world in worlds)
        others = [obj for obj in first.objects.values() if not obj.is_robot]
        self.others = compile_objects(others, size, physics, loose)
        if not self.names and not self.others.bodies:
            raise SimulationError(NOTHING_MOVES)
        self.arrays = _by_first_end(world_arrays(self.others))
        self.object_names = [*self.names, *(body.name for body in self.others.bodies)]

    def rank(self, copies: np.ndarray, lanes: int) -> np.ndarray:
        """An order of the bodies in which those that share packs differ little in what doubles points.

        Args:
            copies: how many environments have each body.
            lanes: of a pack.
        """
        if not self.bodies or len(copies) == 1:
            return np.arange(len(copies))
        split = np.concatenate([bodies.split_nodes() for bodies in self.bodies], axis=1)
        rank, left = np.zeros(len(copies), int), np.arange(len(copies))
        union, room = np.zeros(split.shape[1], bool), 0
        for place in range(len(copies)):
            if room <= 0:  # a new pack begins with a body that doubles few points
                union, room = np.zeros(split.shape[1], bool), lanes
            nearest = int(np.argmin((split[left] & ~union).sum(1)))
            chosen = left[nearest]
            rank[chosen] = place
            union |= split[chosen]
            room -= copies[chosen]
            left = np.delete(left, nearest)
        return rank

    def add(self, worlds: Sequence[World]) -> None:
        """Add the bodies of more worlds, which fit the grid."""
        self.bodies = [
            bodies.join(RobotBodies.of([world.objects[name] for world in worlds], bodies.cells.shape[1:]))
            for name, bodies in zip(self.names, self.bodies, strict=True)
        ]

    def keep(self, kept: np.ndarray) -> None:
        """Forget all bodies but some, bool ``[bodies]``."""
        self.bodies = [bodies.take(kept) for bodies in self.bodies]

    def tables(self, index: np.ndarray) -> dict[str, np.ndarray]:
        """Tables of packs whose lanes hold these bodies, int ``[packs, lanes]``; see :class:`_PackTables`."""
        cells = sum(bodies.cells[0].size for bodies in self.bodies)
        most = max(1, CHUNK // max(1, 200 * cells * index.shape[1]))
        return join([self._tables(index[begin : begin + most]) for begin in range(0, len(index), most)])

    def _tables(self, index: np.ndarray) -> dict[str, np.ndarray]:
        meshes = [
            GridMesh(bodies, index, place, self.physics) for bodies, place in zip(self.bodies, self.places, strict=True)
        ]
        return _PackTables(self, meshes, *index.shape).arrays


class _Numbers:
    """Rows of a table for the entries of a grid that some lane has, counted on from those before it.

    Args:
        present: bool ``[packs, entries]``.
        start: rows in use so far, int ``[packs]``.
    """

    def __init__(self, present: np.ndarray, start: np.ndarray) -> None:
        self.at = np.nonzero(present)
        self.row = np.cumsum(present, axis=1) - 1 + start[:, None]
        self.stop = start + present.sum(1)
        self.place = self.at[0], self.row[self.at]

    def put(self, table: np.ndarray, values: np.ndarray) -> None:
        """Values ``[packs, entries, ...]`` into their rows."""
        table[self.place] = values[self.at]


class _PackTables:
    """Fills the tables of :data:`warpvox.kernels.state.MODEL` for packs of one frame.

    ``arrays`` holds them by name with packs first, and besides ``object_points``, int ``[packs, objects, lanes]``: how
    many points each object has.
    """

    def __init__(self, frame: Frame, meshes: list[GridMesh], packs: int, lanes: int) -> None:
        self.frame, self.meshes, self.packs, self.lanes = frame, meshes, packs, lanes
        self.others = frame.arrays
        self.arrays: dict[str, np.ndarray] = {}
        self._number()
        self._points()
        self._springs()
        self._links()
        self._order_active()
        self._voxels()
        self._objects()

    def _number(self) -> None:
        zero = np.zeros(self.packs, int)
        self.points, self.springs, self.voxels = [], [], []
        stops = [zero, zero, zero]
        for mesh in self.meshes:
            present = np.any(mesh.point, -1), np.any(mesh.spring, -1), np.any(mesh.side, (2, 3))
            for k, (kind, part) in enumerate(zip((self.points, self.springs, self.voxels), present, strict=True)):
                kind.append(_Numbers(part, stops[k]))
                stops[k] = kind[-1].stop
        self.first_point, self.first_spring, self.first_voxel = stops
        counts = {"points": "rest_pos", "springs": "spring_rest", "voxels": "body"}
        for (name, source), stop in zip(counts.items(), stops, strict=True):
            size = len(self.others[source]) // (2 if name == "points" else 1)
            self.arrays[name] = (stop + size).astype(np.int32)
        self.arrays["first_other"] = self.first_voxel.astype(np.int32)

    def _table(self, count: str, *more: int, kind: type = np.int32, fill: int = 0) -> np.ndarray:
        return np.full((self.packs, max(1, int(self.arrays[count].max())), *more), fill, kind)

    def _append(self, table: np.ndarray, first: np.ndarray, count: int, values: np.ndarray | int) -> None:
        """The rows of the other objects, ``count`` from ``first`` on in every pack; lanes are the last axis."""
        if count:
            table[np.arange(self.packs)[:, None], first[:, None] + np.arange(count)] = values

    def _points(self) -> None:
        rest_pos, free = self._table("points", 2, self.lanes, kind=np.float64), self._table("points")
        tied = np.zeros(rest_pos.shape[:2], bool)
        for mesh, numbers in zip(self.meshes, self.points, strict=True):
            numbers.put(rest_pos, np.repeat(mesh.position, 4, axis=1))
            numbers.put(free, pack_bits(mesh.free))
            numbers.put(tied, mesh.link.any((2, 3)))
        others = self.others
        places = others["rest_pos"].reshape(-1, 2, 1)
        self._append(rest_pos, self.first_point, len(places), places)
        self._append(free, self.first_point, len(places), np.where(others["fixed"] == 0, -1, 0))
        held = np.zeros(len(others["fixed"]), bool)
        held[others["spring_ends"].ravel()] = True
        self._append(tied, self.first_point, len(held), held)
        self.active = (free != 0) | tied
        self.arrays["actives"] = self.active.sum(1).astype(np.int32)
        self.arrays["rest_pos"] = rest_pos.reshape(self.packs, -1, self.lanes)
        self.arrays["free_lanes"] = free
        self._twins()

    def _twins(self) -> None:
        """Points that stand for one point in some lanes: (twin, leader) and in which lanes."""
        pairs, masks, counts = [], [], []
        for mesh, numbers in zip(self.meshes, self.points, strict=True):
            nodes = mesh.point.shape[1] // 4
            leader = mesh.leader.reshape(self.packs, nodes, 4, self.lanes)
            point = mesh.point.reshape(leader.shape)
            follows = np.stack([(leader[:, :, s] == t) & point[:, :, s] for s, t in TWIN_PAIRS], axis=2)
            row = numbers.row.reshape(self.packs, nodes, 4)
            pairs.append(np.stack([row[:, :, [s, t]] for s, t in TWIN_PAIRS], axis=2).reshape(self.packs, -1, 2))
            masks.append(follows.reshape(self.packs, -1, self.lanes))
            counts.append(follows.any(-1).sum(2))
        self.arrays["twin_range"] = self._table("points", 2)
        if not self.meshes:
            self.arrays["twins"] = np.zeros(self.packs, np.int32)
        else:
            bits = np.concatenate(masks, axis=1)
            numbers = _Numbers(np.any(bits, -1), np.zeros(self.packs, int))
            self.arrays["twins"] = numbers.stop.astype(np.int32)
        self.arrays["twin"], self.arrays["twin_lanes"] = self._table("twins", 2), self._table("twins")
        if self.meshes:
            numbers.put(self.arrays["twin"], np.concatenate(pairs, axis=1))
            numbers.put(self.arrays["twin_lanes"], pack_bits(bits))
        begin = np.zeros(self.packs, int)
        for points, count in zip(self.points, counts, strict=True):
            stop = begin[:, None] + np.cumsum(count, axis=1)
            spans = np.stack([stop - count, stop], axis=-1)  # [packs, nodes, 2]
            points.put(self.arrays["twin_range"], np.repeat(spans, 4, axis=1))
            begin = stop[:, -1]

    def _springs(self) -> None:
        ends, rest = self._table("springs", 2), self._table("springs", kind=np.float64, fill=1)
        lanes, drive = self._table("springs"), self._table("springs", self.lanes)
        stiffness = self._table("springs", self.lanes, kind=np.float64)
        actions = np.zeros((self.packs, self.lanes), int)
        pack = np.arange(self.packs)[:, None, None]
        for mesh, points, numbers in zip(self.meshes, self.points, self.springs, strict=True):
            numbers.put(ends, points.row[pack, mesh.ends])
            numbers.put(rest, np.broadcast_to(mesh.springs.rest, numbers.row.shape))
            numbers.put(lanes, pack_bits(mesh.spring))
            numbers.put(stiffness, mesh.stiffness)
            drives = np.where(mesh.drive >= 0, mesh.drive + actions[:, None, None, :], -1)
            numbers.put(drive, pack_drives(drives, axis=2))
            actions = actions + mesh.actions
        others = self.others
        first, count = self.first_spring, len(others["spring_rest"])
        self._append(ends, first, count, self.first_point[:, None, None] + others["spring_ends"])
        self._append(rest, first, count, others["spring_rest"])
        self._append(lanes, first, count, -1)
        self._append(stiffness, first, count, others["spring_k"][:, None])
        self.arrays |= dict(
            spring_ends=ends, spring_rest=rest, spring_lanes=lanes, spring_k=stiffness, spring_drive=drive
        )
        self.arrays["actions"] = actions.astype(np.int32)
        self.arrays |= dict(
            alike=(stiffness == stiffness[..., :1]).all((1, 2)).astype(np.int32), stiffness=stiffness[..., 0]
        )
        self._rigid()

    def _rigid(self) -> None:
        numbers, start = [], np.zeros(self.packs, int)
        for mesh in self.meshes:
            numbers.append(_Numbers(mesh.rigid.any(-1).reshape(self.packs, -1), start))
            start = numbers[-1].stop
        others = self.others["rigid_spring"]
        self.arrays["rigids"] = (start + len(others)).astype(np.int32)
        which, lanes = self._table("rigids"), self._table("rigids")
        for mesh, springs, part in zip(self.meshes, self.springs, numbers, strict=True):
            part.put(which, springs.row[:, mesh.springs.of_cell].reshape(self.packs, -1))
            part.put(lanes, pack_bits(mesh.rigid).reshape(self.packs, -1))
        self._append(which, start, len(others), self.first_spring[:, None] + others)
        self._append(lanes, start, len(others), -1)
        self.arrays |= dict(rigid_spring=which, rigid_lanes=lanes)

    def _links(self) -> None:
        """Springs point by point: s where it begins at the point, -1 - s where it ends there; then ends at twins."""
        numbers, start, twin_ends = [], np.zeros(self.packs, int), [np.zeros((0, 5), int)]
        begin = self._table("points")
        begin = np.concatenate([begin, begin[:, :1]], axis=1)
        for mesh, points, springs in zip(self.meshes, self.points, self.springs, strict=True):
            present = mesh.link.any(-1)
            stops = start[:, None] + np.cumsum(present.sum(-1), axis=1)
            points.put(begin[:, 1:], stops)
            numbers.append(_Numbers(present.reshape(self.packs, -1), start))
            start = numbers[-1].stop
            twin_ends.append(self._ends_at_twins(mesh, points, springs, present))
        others = self.others
        self.arrays["links"] = (start + len(others["link"])).astype(np.int32)
        link = self._table("links")
        for mesh, springs, part in zip(self.meshes, self.springs, numbers, strict=True):
            at = np.where(mesh.springs.at_node >= 0, mesh.springs.at_node, 0)
            row = springs.row[:, at]  # [packs, nodes, 12]
            signed = np.where(mesh.springs.end_at_node == 0, row, -1 - row)
            part.put(link, np.repeat(signed, 4, axis=1).reshape(self.packs, -1))
        first = self.first_spring[:, None]
        signed = np.where(others["link"] >= 0, others["link"] + first, others["link"] - first)
        self._append(link, start, len(others["link"]), signed)
        self._append(begin, self.first_point, len(others["link_start"]), start[:, None] + others["link_start"])
        self.arrays |= dict(link_start=begin, link=link)
        del self.arrays["links"]
        rows = np.concatenate(twin_ends)
        rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
        count = np.bincount(rows[:, 0], minlength=self.packs)
        self.arrays["twin_ends"] = count.astype(np.int32)
        table = self._table("twin_ends", 4)
        table[rows[:, 0], np.arange(len(rows)) - (np.cumsum(count) - count)[rows[:, 0]]] = rows[:, 1:]
        self.arrays["twin_end"] = table

    def _order_active(self) -> None:
        """Active points in the order in which the springs, one after another, are done with them."""
        ends, more = self.arrays["spring_ends"], self.arrays["twin_end"]
        last = np.full(self.active.shape, -1)
        pack, spring = np.nonzero(np.arange(ends.shape[1]) < self.arrays["springs"][:, None])
        for end in (0, 1):
            np.maximum.at(last, (pack, ends[pack, spring, end]), spring)
        pack, entry = np.nonzero(np.arange(more.shape[1]) < self.arrays["twin_ends"][:, None])
        np.maximum.at(last, (pack, more[pack, entry, 1]), more[pack, entry, 0])
        order = np.argsort(np.where(self.active, last, ends.shape[1]), axis=1, kind="stable")
        order = order[:, : max(1, int(self.arrays["actives"].max()))]
        self.arrays["active"] = (2 * order[..., None] + [0, 1]).reshape(self.packs, -1).astype(np.int32)
        self.arrays["last_spring"] = np.take_along_axis(last, order, axis=1).astype(np.int32)

    def _ends_at_twins(self, mesh: GridMesh, points: _Numbers, springs: _Numbers, present: np.ndarray) -> np.ndarray:
        """int ``[entries, 5]``: pack, spring, point, end, lanes, where a spring pulls at a twin of its end."""
        at, end = mesh.springs.at_node, mesh.springs.end_at_node
        own = mesh.ends[:, np.maximum(at, 0), end]  # [packs, nodes, 12]
        nodes, slots = own.shape[1], np.arange(4 * own.shape[1]).reshape(1, -1, 4, 1)
        elsewhere = present.reshape(self.packs, nodes, 4, -1) & (slots != own[:, :, None])
        pack, node, slot, n = np.nonzero(elsewhere)
        lanes = pack_bits(mesh.link[pack, 4 * node + slot, n])
        spring, point = springs.row[pack, at[node, n]], points.row[pack, 4 * node + slot]
        return np.stack([pack, spring, point, end[node, n], lanes], axis=1)

    def _voxels(self) -> None:
        corner, sides, grid = self._table("voxels", 4), self._table("voxels", 4), self._table("voxels", 2)
        body, robot, fixed_voxel = self._table("voxels"), self._table("voxels"), self._table("voxels")
        pack = np.arange(self.packs)[:, None, None]
        limits = []
        for number, (mesh, points, voxels) in enumerate(zip(self.meshes, self.points, self.voxels, strict=True)):
            corners = points.row[pack, mesh.corner]
            voxels.put(corner, corners)
            voxels.put(sides, pack_bits(mesh.side))
            row, column = np.divmod(np.arange(corners.shape[1]), mesh.columns)
            voxels.put(grid, np.broadcast_to(np.stack([column, row], axis=-1), (self.packs, len(row), 2)))
            for table in (body, robot):
                voxels.put(table, np.full(voxels.row.shape, number))
            limits.append(mesh.side.any(2).sum(1))
        others, start, robots = self.others, self.first_voxel, len(self.meshes)
        bits = others["side"][:, None] >> np.arange(4) & 1
        corners = others["corner"] + self.first_point[:, None, None]
        for table, values in (
            (corner, corners), (sides, -bits), (grid, others["grid"]), (body, others["body"] + robots), (robot, -1),
            (fixed_voxel, others["fixed_voxel"]),
        ):  # fmt: skip
            self._append(table, start, len(others["body"]), values)
        pushed = np.where(self.active[pack, corner], corner, -1)
        count = len(others["movable"])
        self.arrays["movables"] = (start + count).astype(np.int32)
        movable = self._table("movables")
        row = np.arange(movable.shape[1])
        movable[:] = np.where(row < start[:, None], row, 0)
        self._append(movable, start, count, start[:, None] + others["movable"])
        folds = np.stack(limits, axis=1) if limits else np.zeros((self.packs, 1, self.lanes))
        self.arrays |= dict(
            corner=corner, pushed=pushed, side_lanes=sides, grid=grid, body=body, robot=robot, fixed_voxel=fixed_voxel,
            movable=movable, fold_limit=folds.astype(np.int32), robots=np.full(self.packs, robots, np.int32),
        )  # fmt: skip

    def _objects(self) -> None:
        counts, orders = [], []
        for mesh, points in zip(self.meshes, self.points, strict=True):
            rows = points.row[np.arange(self.packs)[:, None, None], np.maximum(mesh.order, 0)]
            orders.append(np.where(mesh.order >= 0, rows, -1))
            counts.append(mesh.count)
        first = np.broadcast_to(self.first_point[:, None, None], (self.packs, self.lanes, 1))
        for body in self.frame.others.bodies:
            orders.append(first + body.first_point + np.arange(len(body.points)))
            counts.append(np.full((self.packs, self.lanes), len(body.points)))
        rows = np.concatenate(orders, axis=2)
        place = np.argsort(rows < 0, axis=2, kind="stable")
        order = np.take_along_axis(rows, place, axis=2)
        self.arrays["order"] = order.transpose(0, 2, 1).astype(np.int32)
        self.arrays["object_points"] = np.stack(counts, axis=1).astype(np.int32)


def _by_first_end(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays of a world with its springs, and with those of each point, in the order of their lower ends."""
    ends = np.sort(arrays["spring_ends"], axis=1)
    order = np.argsort(ends[:, 0], kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    ends = ends[order]
    spring, end = np.divmod(np.lexsort((np.arange(ends.size), ends.ravel())), 2)
    by_spring = {name: arrays[name][order] for name in ("spring_rest", "spring_k", "spring_drive")}
    link = np.where(end == 0, spring, -1 - spring).astype(np.int32)
    rigid = place[arrays["rigid_spring"]].astype(np.int32)
    return arrays | by_spring | dict(spring_ends=ends, link=link, rigid_spring=rigid)


def capacities(frame: Frame, rows: int, columns: int, cut: bool) -> dict[str, int]:
    """The most points, springs and so on that bodies on a grid may need in one pack of a frame."""
    robots, others = len(frame.names), frame.arrays
    cells, slots = rows * columns, 4 if cut else 2
    points = robots * most_points(rows, columns, cut) + len(others["fixed"])
    sides = (rows + 1) * columns + rows * (columns + 1)
    doubled = (rows - 1) * columns + (rows * (columns - 1) if cut else 0)
    springs = robots * (sides + doubled + 2 * cells)
    return {
        "point": points,
        "active": points,
        "joint": points + 1,
        "row": points,
        "spring": springs + len(others["spring_rest"]),
        "link": 2 * slots * springs + len(others["link"]),
        "rigid": robots * 6 * cells + len(others["rigid_spring"]),
        "twin_end": 2 * (slots - 1) * springs,
        "twin": robots * (rows - 1) * (columns - 1) * (6 if cut else 1),
        "voxel": robots * cells + len(others["body"]),
        "movable": robots * cells + len(others["movable"]),
        "action": robots * cells,
    }
