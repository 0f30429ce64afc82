"""Objects of a batch by name: number of points, and their rows in the simulation's arrays."""

from collections.abc import Sequence

import numpy as np
import torch
import warp as wp

from warpvox.batch.arrays import Buffers
from warpvox.batch.grid_mesh import most_points
from warpvox.batch.packs import Batch
from warpvox.compile import Body, CompiledWorld, compile_world
from warpvox.errors import SimulationError, did_you_mean, listing
from warpvox.kernels.device import from_numpy
from warpvox.types import VOXEL
from warpvox.world import World


class CompiledWorlds(Sequence):
    """Compiled worlds of a batch by index; in fast arithmetic a world is compiled on first access."""

    def __init__(self, batch: Batch) -> None:
        self._batch = batch
        self._made: dict[int, tuple[World, CompiledWorld]] = {}  # by the identity of the world, which is kept with it

    def __len__(self) -> int:
        return len(self._batch.entries)

    def __getitem__(self, number: int) -> CompiledWorld:
        """Return the compiled world with index ``number``."""
        entry = self._batch.entries[number]  # IndexError ends a loop over them
        if self._batch.arithmetic == "exact":
            return self._batch.compiled[entry.group]
        world = entry.world
        if id(world) not in self._made:
            self._made[id(world)] = world, compile_world(world, self._batch.physics, self._batch.loose)
        return self._made[id(world)][1]

    def forget(self) -> None:
        """Drop compiled worlds that the batch no longer uses."""
        used = {id(entry.world) for entry in self._batch.entries}
        self._made = {key: kept for key, kept in self._made.items() if key in used}


class Objects:
    """Names of a batch's objects, and the rows of their points in the simulation's arrays.

    Attributes:
        names: robots first, then by name.
        movable: names of those that can move in some world; ``terrain``: of those that never move in some.
        num_points: by name the most points that an object has in any world (or may have, given ``batch.grid``).
        rows: int ``[num_envs, points]``: the rows of an environment's points in the order of observations, padded with
            the last of them.
        total: int ``[num_envs]``: how many these are.
    """

    def __init__(self, batch: Batch, state: Buffers) -> None:
        self._batch = batch
        self._state = state
        self.names = batch.object_names
        self.movable = {body.name for world in batch.compiled for body in world.bodies}
        self.movable |= {name for frame in batch.frames for name in frame.names}
        self.terrain = {body.name for world in batch.compiled for body in world.statics}
        self.device = state.device
        self.refresh()
        self.num_points = self._most_points()

    def refresh(self) -> None:
        """Update the rows of all points after environments were given other worlds."""
        # The tables of each environment
        state = self._state
        pack = wp.to_torch(state.env_pack).long()
        lane = wp.to_torch(state.env_lane).long()
        mesh = wp.to_torch(state.arrays["pack_mesh"]).long()[pack]

        # Where the points of each object lie in the order of observations: begin and end, [num_envs, objects, 2]
        self.point_range = wp.to_torch(state.arrays["object_range"])[mesh, :, lane].long()
        self.total = self.point_range[..., 1].max(1).values

        # The rows of the points in this order, [num_envs, points]
        order = wp.to_torch(state.arrays["order"])[mesh, :, lane].long()
        last = (self.total - 1).clamp(min=0)[:, None]
        place = torch.minimum(torch.arange(order.shape[1], device=order.device), last)
        self.rows = order.gather(1, place)

        index = np.asarray(self._batch.index)
        _, first = np.unique(index, return_index=True)
        self._example = torch.as_tensor(first, device=order.device)  # an environment of every world

    def index(self, name: str) -> int:
        """Return the index of an object's name in ``names``.

        Raises:
            SimulationError: there is no such object.
        """
        if name not in self.names:
            hint = did_you_mean(name, self.names)
            raise SimulationError(f"No object named {name!r}; there are {listing(self.names)}.{hint}")
        return self.names.index(name)

    def moving(self, name: str) -> int:
        """Return the index of a movable object's name in ``names``.

        Raises:
            SimulationError: there is no such object, or it never moves.
        """
        index = self.index(name)
        if name not in self.movable:
            raise SimulationError(f"The object {name!r} is made of fixed cells only: it never moves.")
        return index

    def _fixed_meshes(self, name: str) -> list[Body | None]:
        """Return the fixed mesh of an object in every frame; None where the object can move or is missing."""
        return [_named(compiled.statics, name) for compiled in self._batch.compiled]

    def counts(self, name: str) -> torch.Tensor:
        """Count an object's points in every world, int ``[worlds]``."""
        points = self.point_range[self._example, self.index(name)]
        counts = points[:, 1] - points[:, 0]
        if name in self.terrain:
            still = [len(body.points) if body else 0 for body in self._fixed_meshes(name)]
            counts = counts + torch.tensor(still, device=counts.device)[self._batch.groups]
        return counts

    def _most_points(self) -> dict[str, int]:
        """Return, by object name, the largest number of points in any world or in any body that ``grid`` allows."""
        moving = self.point_range[self._example]
        counts = (moving[..., 1] - moving[..., 0]).amax(0).tolist()
        most: dict[str, int] = dict(zip(self.names, counts, strict=True))
        for compiled in self._batch.compiled:
            for body in compiled.statics:
                most[body.name] = max(most[body.name], len(body.points))
        if self._batch.grid is not None:
            largest = most_points(*self._batch.grid, self._batch.cut)
            for name in {name for frame in self._batch.frames for name in frame.names}:
                most[name] = max(most[name], largest)
        return most

    def point_mask(self, name: str) -> torch.Tensor:
        """Return a mask of an object's real points in every world, bool ``[worlds, points]``."""
        counts = self.counts(name)[:, None]
        return (torch.arange(self.num_points[name], device=self.device) < counts).cpu()

    def still_points(self, name: str, dtype: torch.dtype, relative: bool) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the positions of an object's fixed points, ``[num_envs, points, 2]``, and their bool mask."""
        bodies = self._fixed_meshes(name)
        fixed = torch.zeros((len(bodies), self.num_points[name], 2), dtype=torch.float64)
        is_fixed = torch.zeros((len(bodies), self.num_points[name], 1), dtype=torch.bool)
        for row, body in enumerate(bodies):
            if body is not None:
                points = torch.tensor(body.points, dtype=torch.float64)
                fixed[row, : len(points)] = points - points.mean(0) if relative else points
                is_fixed[row, : len(points)] = True
        frame = self._batch.frame_of_envs()
        return fixed[frame].to(self.device, dtype), is_fixed[frame].to(self.device)

    def loose_points(self, names: Sequence[str]) -> torch.Tensor:
        """Return the points of loose objects, long ``[num_envs, points, 6]``.

        An entry has the index of the point, the object's cell (x, y) and height, and the point's column and row in it.
        """
        # Of each frame: x, y and height of the object, column and row of its points
        tables: list[list[list[int]]] = []
        for compiled in self._batch.compiled:
            rows = []
            for name in names:
                body = _named(compiled.bodies, name)
                if body is None:
                    if any(name in frame.names for frame in self._batch.frames):
                        raise SimulationError(f"The robot {name!r} can be loose with arithmetic='exact' only.")
                    raise SimulationError(f"All worlds need the loose object {name!r}; one has no object of that name.")
                source = body.source
                for x, y in body.points:
                    column = round(x / VOXEL) - source.x
                    row = source.y + source.height - round(y / VOXEL)
                    rows.append([source.x, source.y, source.height, column, row])
            tables.append(rows)
        if len({len(rows) for rows in tables}) != 1:
            raise SimulationError(f"The loose objects {listing(names)} must have the same cells in all worlds.")
        table = torch.tensor(tables, dtype=torch.long).reshape(len(tables), -1 if tables[0] else 0, 5)
        table = table[self._batch.frame_of_envs()].to(self.device)

        # The rows of these points in each environment
        rows = table[..., 0]
        places = []
        for name in names:
            begin = self.point_range[:, self.index(name), :1]
            places.append(begin + torch.arange(self.num_points[name], device=self.device))
        if places:
            rows = self.rows.gather(1, torch.cat(places, dim=1))
        return torch.cat([rows[..., None], table], dim=2)

    def scan_tables(self, objects: tuple[str, ...] | None) -> tuple[wp.array, wp.array, wp.array]:
        """Return the tables for a terrain scan: fixed points by lattice column, and movable objects.

        First where each column's points start, then the points, then the indices of listed objects that can move.
        """
        for name in objects or ():
            self.index(name)

        # Points that never move, by lattice column
        still = []
        for compiled in self._batch.compiled:
            points = []
            for body in compiled.statics:
                if objects is None or body.name in objects:
                    points += [(x / VOXEL, y / VOXEL) for x, y in body.points]
            still.append(sorted(points, key=lambda p: round(p[0])))

        # As tables of all frames
        moving = [self.index(name) for name in objects or () if name in self.movable]
        columns = max(compiled.width for compiled in self._batch.compiled) + 1
        start = np.zeros((len(still), columns + 1), dtype=np.int32)
        table = np.zeros((len(still), max(1, *(len(points) for points in still)), 2))
        for row, points in enumerate(still):
            start[row] = np.searchsorted([round(x) for x, _ in points], np.arange(columns + 1))
            table[row, : len(points)] = np.reshape(points, (-1, 2))
        return (
            from_numpy(start, int, self.device),
            from_numpy(table, wp.vec2d, self.device),
            from_numpy(moving or [-1], int, self.device),
        )


def _named(bodies: Sequence[Body], name: str) -> Body | None:
    return next((body for body in bodies if body.name == name), None)
