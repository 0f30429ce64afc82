"""Tables of packs (groups of SIMD lanes) whose lanes hold different bodies, for fast arithmetic.

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


def frame_key(world: World) -> tuple:
    """Return a key of a world: equal for worlds that differ only in the cells of their robots."""
    objects = sorted(world.objects.values(), key=lambda obj: obj.name)
    robots = tuple((obj.name, obj.x, obj.y) for obj in objects if obj.is_robot)
    others = tuple(obj.key() for obj in objects if not obj.is_robot)
    return robots, others


def is_cut(obj: WorldObject) -> bool:
    """Return whether an object has neighbouring cells without a connection."""
    filled = obj.grid != 0
    beside = np.count_nonzero(filled[:, 1:] & filled[:, :-1])
    above = np.count_nonzero(filled[1:] & filled[:-1])
    return beside + above != len(obj.connections)


class Frame:
    """Common data of all worlds of a group (places of robots, other objects), and the tables of their packs.

    Args:
        worlds: all of one frame.
        physics: its stiffnesses go into the tables.
        loose: see :class:`warpvox.Simulation`.
        grid: rows and columns that robots may have at least.
    """

    def __init__(
        self, worlds: Sequence[World], physics: Physics, loose: Sequence[str], grid: tuple[int, int] = (1, 1)
    ) -> None:
        # Robots, by name
        objects = worlds[0].objects
        self.physics = physics
        self.names = sorted(name for name, obj in objects.items() if obj.is_robot)
        self.places = [(objects[name].x, objects[name].y) for name in self.names]
        self.bodies = [self._bodies(name, worlds, grid) for name in self.names]

        # Other objects
        size = max(world.width for world in worlds), max(world.height for world in worlds)
        others = [obj for obj in objects.values() if not obj.is_robot]
        self.others = compile_objects(others, size, physics, loose)
        if not self.names and not self.others.bodies:
            raise SimulationError(NOTHING_MOVES)
        self.arrays = _by_first_end(_active_first(world_arrays(self.others)))
        self.object_names = [*self.names, *(body.name for body in self.others.bodies)]

    @staticmethod
    def _bodies(name: str, worlds: Sequence[World], grid: tuple[int, int]) -> RobotBodies:
        return RobotBodies.of([world.objects[name] for world in worlds], grid)

    def rank(self, copies: np.ndarray, lanes: int) -> np.ndarray:
        """Return the order of bodies by similarity, int ``[bodies]``, so that one pack doubles few points.

        Args:
            copies: how many environments have each body.
            lanes: of a pack.
        """
        if not self.bodies or len(copies) == 1:
            return np.arange(len(copies))
        # Nodes at which each body doubles a point, bool [bodies, nodes of all robots]
        split = np.concatenate([bodies.split_nodes() for bodies in self.bodies], axis=1)

        # Greedily: the next body is the one that adds the fewest nodes to those of its pack
        rank = np.zeros(len(copies), int)
        remaining = np.arange(len(copies))
        union = np.zeros(split.shape[1], bool)
        free_lanes = 0
        for place in range(len(copies)):
            if free_lanes <= 0:  # a new pack begins with a body that doubles few points
                union[:] = False
                free_lanes = lanes
            added = (split[remaining] & ~union).sum(1)
            nearest = int(np.argmin(added))
            chosen = remaining[nearest]
            rank[chosen] = place
            union |= split[chosen]
            free_lanes -= copies[chosen]
            remaining = np.delete(remaining, nearest)
        return rank

    def add(self, worlds: Sequence[World]) -> None:
        """Add the robot bodies of more worlds, which must fit the grid."""
        for k, name in enumerate(self.names):
            bodies = self.bodies[k]
            self.bodies[k] = bodies.join(self._bodies(name, worlds, bodies.cells.shape[1:]))

    def keep(self, kept: np.ndarray) -> None:
        """Drop the bodies where the mask ``kept``, bool ``[bodies]``, is False."""
        self.bodies = [bodies.take(kept) for bodies in self.bodies]

    def tables(self, index: np.ndarray) -> dict[str, np.ndarray]:
        """Make the tables of packs whose lanes hold the bodies with these indices, int ``[packs, lanes]``."""
        # So many packs at once that the largest array has a million entries: it stays in the cache.
        cells = sum(bodies.cells[0].size for bodies in self.bodies)
        most = max(1, 1_000_000 // max(1, 200 * cells * index.shape[1]))
        parts = []
        for begin in range(0, len(index), most):
            part = index[begin : begin + most]
            meshes = []
            for bodies, place in zip(self.bodies, self.places, strict=True):
                meshes.append(GridMesh(bodies, part, place, self.physics))
            parts.append(_PackTables(self, meshes, *part.shape).arrays)
        return join(parts)


class _Rows:
    """Numbering of table rows: each entry of a grid that some lane uses gets the next free row.

    Attributes:
        row: int ``[packs, entries]``; of an entry that no lane has, that of the one before it.
        stop: int ``[packs]``: rows in use, those of these entries included.

    Args:
        present: bool ``[packs, entries]``.
        start: rows in use so far, int ``[packs]``.
    """

    def __init__(self, present: np.ndarray, start: np.ndarray) -> None:
        self.row = np.cumsum(present, axis=1) - 1 + start[:, None]
        self.stop = start + present.sum(1)
        self._source = np.nonzero(present)
        self._target = self._source[0], self.row[self._source]

    def put(self, table: np.ndarray, values: np.ndarray) -> None:
        """Write the values of the entries, ``[packs, entries, ...]``, into their rows of ``table``."""
        table[self._target] = values[self._source]


class _PackTables:
    """The tables of :data:`warpvox.kernels.state.MODEL` for packs of one frame.

    The rows of robots come first in each table, then those of the other objects, which are the same in all packs and
    lanes. ``arrays`` holds the tables by name with packs first, and besides ``object_points``, int ``[packs, objects,
    lanes]``: how many points each object has.
    """

    def __init__(self, frame: Frame, meshes: list[GridMesh], packs: int, lanes: int) -> None:
        self.frame = frame
        self.meshes = meshes
        self.packs = packs
        self.lanes = lanes
        self.others = frame.arrays
        self.arrays: dict[str, np.ndarray] = {}
        self._assign_rows()
        self._points()
        self._twins()
        self._springs()
        self._rigid()
        self._links()
        self._twin_ends()
        self._order_active()
        self._voxels()
        self._objects()

    def _assign_rows(self) -> None:
        """Assign a table row to each point, spring and surface voxel that some lane uses."""
        # Rows of the points, springs and voxels of each robot that some lane has
        self.points: list[_Rows] = []
        self.springs: list[_Rows] = []
        self.voxels: list[_Rows] = []
        self.first_point = self.first_spring = self.first_voxel = np.zeros(self.packs, int)
        for mesh in self.meshes:
            points = _Rows(np.any(mesh.point, -1), self.first_point)
            springs = _Rows(np.any(mesh.spring, -1), self.first_spring)
            voxels = _Rows(np.any(mesh.side, (2, 3)), self.first_voxel)
            self.points.append(points)
            self.springs.append(springs)
            self.voxels.append(voxels)
            self.first_point = points.stop
            self.first_spring = springs.stop
            self.first_voxel = voxels.stop

        # The other objects begin behind them.
        self._store_count("points", self.first_point, len(self.others["fixed"]))
        self._store_count("springs", self.first_spring, len(self.others["spring_rest"]))
        self._store_count("voxels", self.first_voxel, len(self.others["body"]))
        self._store_count("first_other", self.first_voxel, 0)

    def _store_count(self, name: str, robots: np.ndarray, others: int) -> None:
        """Store the number of elements in each pack: ``robots``, int ``[packs]``, plus ``others``."""
        self.arrays[name] = (robots + others).astype(np.int32)

    def _table(self, count: str, *more: int, kind: type = np.int32, fill: int = 0) -> np.ndarray:
        """Allocate a table ``[packs, rows, *more]`` filled with ``fill``; ``count`` says how many rows are used."""
        rows = max(1, int(self.arrays[count].max()))
        return np.full((self.packs, rows, *more), fill, kind)

    def _append(self, table: np.ndarray, first: np.ndarray, count: int, values: np.ndarray | int) -> None:
        """Write rows of the objects that are no robots into the tables of all packs, from row ``first`` on.

        Lanes are the last axis of ``values``.
        """
        if count:
            pack = np.arange(self.packs)[:, None]
            row = first[:, None] + np.arange(count)
            table[pack, row] = values

    def _points(self) -> None:
        """Make the tables of points: initial positions, lanes in which a point is free, active points."""
        rest_pos = self._table("points", 2, self.lanes, kind=np.float64)
        free_lanes = self._table("points")
        tied = np.zeros(free_lanes.shape, bool)  # a spring ends here

        # Robots: the four points of a node lie at one place.
        for mesh, points in zip(self.meshes, self.points, strict=True):
            points.put(rest_pos, np.repeat(mesh.position, 4, axis=1))
            points.put(free_lanes, pack_bits(mesh.free))
            points.put(tied, mesh.link.any((2, 3)))

        # Other objects, active points first
        fixed = self.others["fixed"]
        self._append(rest_pos, self.first_point, len(fixed), self.others["rest_pos"].reshape(-1, 2, 1))
        self._append(free_lanes, self.first_point, len(fixed), np.where(fixed == 0, -1, 0))
        self._append(tied, self.first_point, int(self.others["actives"]), 1)

        self.active = (free_lanes != 0) | tied  # [packs, points]
        self._store_count("actives", self.active.sum(1), 0)
        self.arrays["rest_pos"] = rest_pos.reshape(self.packs, -1, self.lanes)
        self.arrays["free_lanes"] = free_lanes

    def _twins(self) -> None:
        """Make the table of twins (pairs of points that coincide in some lanes), with a mask of these lanes."""
        twin_slot = [twin for twin, _ in TWIN_PAIRS]
        leader_slot = [leader for _, leader in TWIN_PAIRS]
        all_pairs = [np.zeros((self.packs, 0, 2), int)]
        all_follows = [np.zeros((self.packs, 0, self.lanes), bool)]
        twin_range = self._table("points", 2)
        stop = np.zeros(self.packs, int)  # twins so far
        for mesh, points in zip(self.meshes, self.points, strict=True):
            # Where a slot of a node follows another one, bool [packs, nodes, 6 pairs, lanes]
            nodes = mesh.point.shape[1] // 4
            leader = mesh.leader.reshape(self.packs, nodes, 4, self.lanes)
            point = mesh.point.reshape(leader.shape)
            follows = (leader[:, :, twin_slot] == np.array(leader_slot)[:, None]) & point[:, :, twin_slot]
            all_follows.append(follows.reshape(self.packs, -1, self.lanes))

            # The rows of both
            row = points.row.reshape(self.packs, nodes, 4)
            pairs = np.stack([row[:, :, twin_slot], row[:, :, leader_slot]], axis=-1)
            all_pairs.append(pairs.reshape(self.packs, -1, 2))

            # The points of a node share a range of twins: begin and end
            count = follows.any(-1).sum(2)  # [packs, nodes]
            stops = stop[:, None] + np.cumsum(count, axis=1)
            ranges = np.stack([stops - count, stops], axis=-1)
            points.put(twin_range, np.repeat(ranges, 4, axis=1))
            stop = stops[:, -1]

        # Pairs of which some lane has none are left out.
        follows = np.concatenate(all_follows, axis=1)
        rows = _Rows(np.any(follows, -1), np.zeros(self.packs, int))
        self._store_count("twins", rows.stop, 0)
        twin = self._table("twins", 2)
        twin_lanes = self._table("twins")
        rows.put(twin, np.concatenate(all_pairs, axis=1))
        rows.put(twin_lanes, pack_bits(follows))
        self.arrays["twin_range"] = twin_range
        self.arrays["twin"] = twin
        self.arrays["twin_lanes"] = twin_lanes

    def _springs(self) -> None:
        """Make the tables of springs: ends, lengths, stiffness, and the actions that drive them."""
        spring_ends = self._table("springs", 2)
        rest = self._table("springs", kind=np.float64, fill=1)
        spring_lanes = self._table("springs")
        spring_drive = self._table("springs", self.lanes)
        stiffness = self._table("springs", self.lanes, kind=np.float64)

        # Robots: their actions count on
        actions = np.zeros((self.packs, self.lanes), int)
        pack = np.arange(self.packs)[:, None, None]
        for mesh, points, springs in zip(self.meshes, self.points, self.springs, strict=True):
            springs.put(spring_ends, points.row[pack, mesh.ends])
            springs.put(rest, np.broadcast_to(mesh.springs.rest, springs.row.shape))
            springs.put(spring_lanes, pack_bits(mesh.spring))
            springs.put(stiffness, mesh.stiffness)
            drive = np.where(mesh.drive >= 0, mesh.drive + actions[:, None, None, :], -1)
            springs.put(spring_drive, pack_drives(drive, axis=2))
            actions = actions + mesh.actions

        # Other objects: nothing drives their springs
        first = self.first_spring
        count = len(self.others["spring_rest"])
        self._append(spring_ends, first, count, self.first_point[:, None, None] + self.others["spring_ends"])
        self._append(rest, first, count, self.others["spring_rest"])
        self._append(spring_lanes, first, count, -1)
        self._append(stiffness, first, count, self.others["spring_k"][:, None])

        self.arrays["spring_ends"] = spring_ends
        self.arrays["spring_rest"] = rest
        self.arrays["spring_lanes"] = spring_lanes
        self.arrays["spring_k"] = stiffness
        self.arrays["spring_drive"] = spring_drive
        self.arrays["actions"] = actions.astype(np.int32)

        # Where all lanes have equal springs, a kernel reads one stiffness for all
        self.arrays["alike"] = (stiffness == stiffness[..., :1]).all((1, 2)).astype(np.int32)
        self.arrays["stiffness"] = stiffness[..., 0]

    def _rigid(self) -> None:
        """Make the table of springs that are sides of rigid voxels, with a mask of lanes for each."""
        rigid_rows = []
        start = np.zeros(self.packs, int)  # sides so far
        for mesh in self.meshes:
            present = mesh.rigid.any(-1)  # [packs, cells, 6]
            rows = _Rows(present.reshape(self.packs, -1), start)
            rigid_rows.append(rows)
            start = rows.stop
        others = self.others["rigid_spring"]
        self._store_count("rigids", start, len(others))

        rigid_spring = self._table("rigids")
        rigid_lanes = self._table("rigids")
        for mesh, springs, rows in zip(self.meshes, self.springs, rigid_rows, strict=True):
            sides = springs.row[:, mesh.springs.of_cell]  # [packs, cells, 6]
            rows.put(rigid_spring, sides.reshape(self.packs, -1))
            rows.put(rigid_lanes, pack_bits(mesh.rigid).reshape(self.packs, -1))
        self._append(rigid_spring, start, len(others), self.first_spring[:, None] + others)
        self._append(rigid_lanes, start, len(others), -1)
        self.arrays["rigid_spring"] = rigid_spring
        self.arrays["rigid_lanes"] = rigid_lanes

    def _links(self) -> None:
        """Make the table of springs at each point: s if spring s begins there, -1 - s if it ends there."""
        others = self.others
        num_others = len(others["link"])

        # Where the links of each point begin; robots first, then the other objects
        link_start = self._table("points")
        link_start = np.concatenate([link_start, link_start[:, :1]], axis=1)  # [packs, points + 1]
        link_rows = []
        start = np.zeros(self.packs, int)  # links so far
        for mesh, points in zip(self.meshes, self.points, strict=True):
            present = mesh.link.any(-1)  # [packs, grid points, 12]
            stops = start[:, None] + np.cumsum(present.sum(-1), axis=1)
            points.put(link_start[:, 1:], stops)
            rows = _Rows(present.reshape(self.packs, -1), start)
            link_rows.append(rows)
            start = rows.stop
        self._append(link_start, self.first_point, len(others["link_start"]), start[:, None] + others["link_start"])

        # The links of robots: the four points of a node share the 12 springs around it
        size = max(1, int(start.max()) + num_others)
        link = np.zeros((self.packs, size), np.int32)
        for mesh, springs, rows in zip(self.meshes, self.springs, link_rows, strict=True):
            at_node = np.maximum(mesh.springs.at_node, 0)  # [nodes, 12]; where there is no spring, nothing is present
            spring = springs.row[:, at_node]  # [packs, nodes, 12]
            signed = np.where(mesh.springs.end_at_node == 0, spring, -1 - spring)
            rows.put(link, np.repeat(signed, 4, axis=1).reshape(self.packs, -1))

        # The links of the other objects, whose springs come after those of robots
        first = self.first_spring[:, None]
        signed = np.where(others["link"] >= 0, others["link"] + first, others["link"] - first)
        self._append(link, start, num_others, signed)
        self.arrays["link_start"] = link_start
        self.arrays["link"] = link

    def _twin_ends(self) -> None:
        """Make the table of spring ends at twin points: spring, point, end and lanes, sorted by spring."""
        parts = [np.zeros((0, 5), int)]
        for mesh, points, springs in zip(self.meshes, self.points, self.springs, strict=True):
            at_node = mesh.springs.at_node  # [nodes, 12]: springs around a node, -1: none
            end_at_node = mesh.springs.end_at_node  # [nodes, 12]: 0: the spring begins there, 1: it ends there
            nodes = len(at_node)

            # The point that a spring has at this node, as a number on the grid: 4 * node + slot
            own_point = mesh.ends[:, np.maximum(at_node, 0), end_at_node]  # [packs, nodes, 12]

            # The other points of the node at which it pulls in some lane
            pulls = mesh.link.any(-1).reshape(self.packs, nodes, 4, 12)
            grid_points = np.arange(4 * nodes).reshape(1, nodes, 4, 1)
            elsewhere = pulls & (grid_points != own_point[:, :, None])
            pack, node, slot, k = np.nonzero(elsewhere)

            # An entry for each, in rows of the tables
            grid_point = 4 * node + slot
            spring = springs.row[pack, at_node[node, k]]
            point = points.row[pack, grid_point]
            end = end_at_node[node, k]
            lanes = pack_bits(mesh.link[pack, grid_point, k])
            parts.append(np.stack([pack, spring, point, end, lanes], axis=1))
        entries = np.concatenate(parts)
        order = np.lexsort((entries[:, 1], entries[:, 0]))  # by pack, then by spring
        entries = entries[order]

        # The entries of a pack are its first rows
        pack = entries[:, 0]
        count = np.bincount(pack, minlength=self.packs)
        first = np.cumsum(count) - count  # [packs]
        row = np.arange(len(entries)) - first[pack]
        self._store_count("twin_ends", count, 0)
        table = self._table("twin_ends", 4)
        table[pack, row] = entries[:, 1:]
        self.arrays["twin_end"] = table

    def _order_active(self) -> None:
        """Make the table of active points, sorted by the last spring that acts on them."""
        spring_ends = self.arrays["spring_ends"]  # [packs, springs, 2]
        twin_end = self.arrays["twin_end"]  # [packs, entries, 4]: spring, point, end, lanes
        num_springs = spring_ends.shape[1]

        # The last spring that ends at each point; -1: none does
        last_spring = np.full(self.active.shape, -1)  # [packs, points]
        pack, spring = np.nonzero(np.arange(num_springs) < self.arrays["springs"][:, None])
        for end in (0, 1):
            point = spring_ends[pack, spring, end]
            np.maximum.at(last_spring, (pack, point), spring)

        # ... or that pulls at it as a twin
        pack, entry = np.nonzero(np.arange(twin_end.shape[1]) < self.arrays["twin_ends"][:, None])
        spring = twin_end[pack, entry, 0]
        point = twin_end[pack, entry, 1]
        np.maximum.at(last_spring, (pack, point), spring)

        # Sort by it. Points that are not active come last, and are cut off.
        key = np.where(self.active, last_spring, num_springs)
        most = max(1, int(self.arrays["actives"].max()))
        order = np.argsort(key, axis=1, kind="stable")[:, :most]  # [packs, actives]
        self.arrays["last_spring"] = np.take_along_axis(last_spring, order, axis=1).astype(np.int32)

        # Point p has its x in row 2 p of the positions, its y in row 2 p + 1
        rows = np.stack([2 * order, 2 * order + 1], axis=-1)
        self.arrays["active"] = rows.reshape(self.packs, -1).astype(np.int32)

    def _voxels(self) -> None:
        """Make the tables of surface voxels: corners, sides, cells, owners, and which can move."""
        corner = self._table("voxels", 4)
        side_lanes = self._table("voxels", 4)
        grid = self._table("voxels", 2)
        body = self._table("voxels")
        robot = self._table("voxels")
        fixed_voxel = self._table("voxels")

        # Robots, which also say how many surface voxels each has in each lane
        pack = np.arange(self.packs)[:, None, None]
        num_robots = len(self.meshes)
        fold_limit = np.zeros((self.packs, max(1, num_robots), self.lanes), np.int32)
        for number, (mesh, points, voxels) in enumerate(zip(self.meshes, self.points, self.voxels, strict=True)):
            voxels.put(corner, points.row[pack, mesh.corner])
            voxels.put(side_lanes, pack_bits(mesh.side))
            row, column = np.divmod(np.arange(mesh.corner.shape[1]), mesh.columns)
            cell = np.stack([column, row], axis=-1)
            voxels.put(grid, np.broadcast_to(cell, (self.packs, *cell.shape)))
            owner = np.full(voxels.row.shape, number)
            voxels.put(body, owner)
            voxels.put(robot, owner)
            fold_limit[:, number] = mesh.side.any(2).sum(1)

        # Other objects
        others = self.others
        first = self.first_voxel
        count = len(others["body"])
        sides = others["side"][:, None] >> np.arange(4) & 1
        self._append(corner, first, count, others["corner"] + self.first_point[:, None, None])
        self._append(side_lanes, first, count, -sides)
        self._append(grid, first, count, others["grid"])
        self._append(body, first, count, others["body"] + num_robots)
        self._append(robot, first, count, -1)
        self._append(fixed_voxel, first, count, others["fixed_voxel"])

        # Voxels that can move: all of robots, some of the other objects
        self._store_count("movables", first, len(others["movable"]))
        movable = self._table("movables")
        row = np.arange(movable.shape[1])
        movable[:] = np.where(row < first[:, None], row, 0)
        self._append(movable, first, len(others["movable"]), first[:, None] + others["movable"])

        self.arrays["corner"] = corner
        self.arrays["pushed"] = np.where(self.active[pack, corner], corner, -1)
        self.arrays["side_lanes"] = side_lanes
        self.arrays["grid"] = grid
        self.arrays["body"] = body
        self.arrays["robot"] = robot
        self.arrays["fixed_voxel"] = fixed_voxel
        self.arrays["movable"] = movable
        self.arrays["fold_limit"] = fold_limit
        self.arrays["robots"] = np.full(self.packs, num_robots, np.int32)

    def _objects(self) -> None:
        """Make the table of each object's points in the order of observations, and count them."""
        counts = []  # [packs, lanes] each
        orders = []  # [packs, lanes, points] each, -1: none

        # Robots
        pack = np.arange(self.packs)[:, None, None]
        for mesh, points in zip(self.meshes, self.points, strict=True):
            row = points.row[pack, np.maximum(mesh.order, 0)]
            orders.append(np.where(mesh.order >= 0, row, -1))
            counts.append(mesh.count)

        # Other objects
        first = np.broadcast_to(self.first_point[:, None, None], (self.packs, self.lanes, 1))
        for body in self.frame.others.bodies:
            end = body.first_point + len(body.points)
            orders.append(first + self.others["order"][body.first_point : end])
            counts.append(np.full((self.packs, self.lanes), len(body.points)))

        # Gaps go to the end
        rows = np.concatenate(orders, axis=2)
        present_first = np.argsort(rows < 0, axis=2, kind="stable")
        order = np.take_along_axis(rows, present_first, axis=2)
        self.arrays["order"] = order.transpose(0, 2, 1).astype(np.int32)
        self.arrays["object_points"] = np.stack(counts, axis=1).astype(np.int32)


def _active_first(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Put the active points, which are free or hang on a spring, before the others in a world's arrays.

    A group of threads goes through the rows up to the last active point. ``order``, the new number of each point, is
    added; active points remain in their order, and so do the others.
    """
    active = np.isin(np.arange(len(arrays["fixed"])), arrays["active"] // 2)
    former = np.argsort(~active, kind="stable")
    number = np.argsort(former)
    return arrays | {
        "order": number,
        "fixed": arrays["fixed"][former],
        "rest_pos": arrays["rest_pos"].reshape(-1, 2)[former].ravel(),
        "spring_ends": number[arrays["spring_ends"]],
        "corner": number[arrays["corner"]],
    }


def _by_first_end(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Sort the springs in a world's arrays by the lower index of their two points."""
    ends = np.sort(arrays["spring_ends"], axis=1)
    order = np.argsort(ends[:, 0], kind="stable")
    ends = ends[order]
    new = arrays | {"spring_ends": ends}
    for name in ("spring_rest", "spring_k", "spring_drive"):
        new[name] = arrays[name][order]

    # Springs have new numbers
    number = np.argsort(order)
    new["rigid_spring"] = number[arrays["rigid_spring"]].astype(np.int32)

    # Springs point by point
    entry = np.lexsort((np.arange(ends.size), ends.ravel()))
    spring, end = np.divmod(entry, 2)
    new["link"] = np.where(end == 0, spring, -1 - spring).astype(np.int32)
    new["link_start"] = np.searchsorted(ends.ravel()[entry], np.arange(len(arrays["fixed"]) + 1))
    return new


def capacities(frame: Frame, rows: int, columns: int, cut: bool) -> dict[str, int]:
    """Return the largest numbers of points, springs, ... that a pack needs for bodies up to a grid size."""
    robots = len(frame.names)
    others = frame.arrays
    cells = rows * columns
    inner_nodes = (rows - 1) * (columns - 1)
    slots = 4 if cut else 2  # points that a node may have

    # Springs: the sides of cells, those that may stand twice, and two diagonals a cell
    sides = (rows + 1) * columns + rows * (columns + 1)
    doubled = (rows - 1) * columns
    if cut:
        doubled += rows * (columns - 1)
    springs = robots * (sides + doubled + 2 * cells)

    robot_points = robots * most_points(rows, columns, cut)
    points = robot_points + len(others["fixed"])
    return {
        "point": points,
        "active": robot_points + int(others["actives"]),
        "joint": points + 1,
        "row": points,
        "spring": springs + len(others["spring_rest"]),
        "link": 2 * slots * springs + len(others["link"]),
        "rigid": robots * 6 * cells + len(others["rigid_spring"]),
        "twin_end": 2 * (slots - 1) * springs,
        "twin": robots * inner_nodes * (len(TWIN_PAIRS) if cut else 1),
        "voxel": robots * cells + len(others["body"]),
        "movable": robots * cells + len(others["movable"]),
        "action": robots * cells,
    }
