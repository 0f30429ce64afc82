"""Assignment of environments to packs and lanes, and the tables of these packs."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import InitVar, dataclass, field
from typing import NamedTuple

import numpy as np

from warpvox.batch.frames import Frame, capacities, frame_key, is_cut
from warpvox.batch.levels import by_level
from warpvox.batch.options import ResolvedOptions, choose_lanes
from warpvox.compile import compile_world, exact_tables, join
from warpvox.contact_order import no_order
from warpvox.errors import SimulationError
from warpvox.world import World

Actuators = tuple[tuple[str, int], ...]
"""Name and number of actuators of each robot in a world."""


def group(worlds: Sequence[World]) -> tuple[dict[bytes, World], list[int]]:
    """Deduplicate worlds: return the distinct ones by key, and the index of each world's key."""
    seen: dict[bytes, int] = {}
    by_id: dict[int, int] = {}
    different = {}
    index = []
    for world in worlds:
        if id(world) not in by_id:
            key = world.key()
            by_id[id(world)] = seen.setdefault(key, len(seen))
            different.setdefault(key, world.copy())
        index.append(by_id[id(world)])
    return different, index


def _actuators(world: World) -> Actuators:
    """Count the actuators of each robot of a world; SimulationError: there are too many."""
    found = tuple(sorted((obj.name, obj.num_actuators) for obj in world.objects.values() if obj.is_robot))
    total = sum(count for _, count in found)
    most = 0xFFFF  # the two actions of a spring share 32 bits (warpvox.compile.pack_drives)
    if total > most:
        raise SimulationError(f"The robots of a world may have {most:,} actuators together, got {total:,}.")
    return found


class Entry(NamedTuple):
    """A distinct world of a batch, and the group of worlds that it may share packs with.

    Attributes:
        key: what :meth:`World.key` gives.
        actuators: the name and the number of actuators of each robot, by name.
        group: worlds of one group may share packs: equal ones in exact arithmetic, else those of one frame.
    """

    key: bytes
    world: World
    actuators: Actuators
    group: int


@dataclass
class Batch:
    """The worlds of all environments, and the pack and lane of each environment.

    Args:
        different: the worlds, by their keys. index: the number of each environment's world.
        options: in ``exact`` arithmetic packs hold one world each; in ``fast`` any worlds of one frame (see
            :mod:`warpvox.batch.frames`).
        layout: 'lanes', or 'group', whose packs have one lane each.

    Attributes:
        entries: the different worlds. Those of one frame stand in the order of its bodies.
        compiled: of each group what its worlds have in common.
        env_pack, env_lane: int ``[num_envs]``.
        lane_world: int ``[packs, lanes]``; lanes without an environment repeat the one before them.
        object_names: of all worlds, robots first, then by name.
    """

    different: InitVar[Mapping[bytes, World]]
    index: list[int]
    options: ResolvedOptions
    loose: tuple[str, ...] = ()
    layout: str = "lanes"
    pack_group: list[int] = field(default_factory=list)

    def __post_init__(self, different: Mapping[bytes, World]) -> None:
        """Group the worlds, assign the environments to packs and lanes, and check the bodies against ``grid``."""
        self.physics = self.options.physics
        self.arithmetic = self.options.arithmetic
        self.device = self.options.device
        self.grid = self.options.grid

        # Groups of worlds that may share packs
        exact = self.arithmetic == "exact"
        numbers: dict[bytes | tuple, int] = {}
        self.entries: list[Entry] = []
        for key, world in different.items():
            number = numbers.setdefault(key if exact else frame_key(world), len(numbers))
            self.entries.append(Entry(key, world, _actuators(world), number))

        # What the worlds of a group have in common
        worlds = list(different.values())
        self.frames: list[Frame] = []
        if exact:
            self.compiled = [compile_world(world, self.physics, self.loose) for world in worlds]
        else:
            for number in range(len(numbers)):
                own = [entry.world for entry in self.entries if entry.group == number]
                self.frames.append(Frame(own, self.physics, self.loose, self.grid or (1, 1)))
            self.compiled = [frame.others for frame in self.frames]

        # Packs: the environments of a group in the order of their worlds, so many to a pack as it has lanes. The last
        # pack of a group repeats its last world.
        groups = self.frame_of_envs()
        self.lanes = 1 if self.layout == "group" else choose_lanes(groups, self.options.lanes, self.device)
        index = np.asarray(self.index)
        self.env_pack = np.zeros(len(index), np.int32)
        self.env_lane = np.zeros(len(index), np.int32)
        lane_world = []
        for number in range(len(numbers)):
            members = np.flatnonzero(groups == number)
            rank = self._rank(number)[index[members]]
            members = members[np.argsort(rank, kind="stable")]
            place = np.arange(len(members))
            self.env_pack[members] = len(self.pack_group) + place // self.lanes
            self.env_lane[members] = place % self.lanes
            packs = math.ceil(len(members) / self.lanes)
            self.pack_group += [number] * packs
            lane_world.append(np.pad(index[members], (0, packs * self.lanes - len(members)), mode="edge"))
        self.lane_world = np.concatenate(lane_world).reshape(-1, self.lanes)

        # Objects by name
        robot = {obj.name: obj.is_robot for world in worlds for obj in world.objects.values()}
        self.object_names = sorted(robot, key=lambda name: (not robot[name], name))
        self.cut = any(is_cut(obj) for world in worlds for obj in world.objects.values() if obj.is_robot)
        if self.grid is not None:
            for world in worlds:
                self._check_bodies(world, self.grid)

    def _check_bodies(self, world: World, grid: tuple[int, int]) -> None:
        """Raise SimulationError if a robot of the world does not fit ``grid`` or lacks connections.

        A body must not be larger than ``grid`` (rows, columns). If every first body had all neighbouring cells
        connected, this one must, too.
        """
        rows, columns = grid
        for obj in world.objects.values():
            if obj.is_robot and (obj.height > rows or obj.width > columns):
                raise SimulationError(
                    f"The {obj.height}x{obj.width} body of {obj.name!r} does not fit the simulation's grid of"
                    f" {rows}x{columns}."
                )
            if obj.is_robot and not self.cut and is_cut(obj):
                raise SimulationError(
                    f"Neighbouring cells of {obj.name!r} are not connected; the simulation was made for connected ones."
                )

    def _rank(self, group: int) -> np.ndarray:
        """Return the order in which a group's worlds fill packs, similar bodies side by side, int ``[entries]``.

        A pack computes everything that one of its lanes needs, so that similar bodies in a pack save time.
        """
        rank = np.arange(len(self.entries))
        if self.arithmetic == "fast" and self.layout == "lanes":
            members = self.groups == group
            copies = np.bincount(np.asarray(self.index), minlength=len(self.entries))[members]
            rank[members] = self.frames[group].rank(copies, self.lanes)
        return rank

    @property
    def groups(self) -> np.ndarray:
        """Index of each distinct world's group (worlds that may share packs), int ``[entries]``."""
        return np.array([entry.group for entry in self.entries])

    def replace(self, envs: Sequence[int], worlds: Sequence[World]) -> np.ndarray:
        """Give environments other worlds of the same frame; return the indices of the packs that changed.

        Raises:
            SimulationError: the batch has no ``grid``, or a world does not belong to it.
        """
        if self.grid is None:
            raise SimulationError("Worlds can be exchanged in a simulation made with grid=(rows, columns) only.")
        examples = {entry.group: entry.world for entry in self.entries}
        group_of = {frame_key(world): group for group, world in examples.items()}
        different = {id(world): world for world in worlds}
        keys = {number: world.key() for number, world in different.items()}

        # The entry of each new world; worlds that the batch does not have yet are added
        entries = {entry.key: entry for entry in self.entries}
        added: dict[int, list[Entry]] = {}
        chosen = []
        for env, world in zip(envs, worlds, strict=True):
            key = keys[id(world)]
            chosen.append(key)
            new = key not in entries
            group = group_of.get(frame_key(world)) if new else entries[key].group
            if group is None or group != self.entries[self.index[env]].group:
                raise SimulationError(
                    f"Environment {env} can be given worlds that differ from its own in the bodies of robots only."
                )
            if new:
                self._check_bodies(world, self.grid)
                entries[key] = Entry(key, world.copy(), _actuators(world), group)
                added.setdefault(group, []).append(entries[key])
        for group, more in added.items():
            self.frames[group].add([entry.world for entry in more])
            self.entries += more
        place = {entry.key: k for k, entry in enumerate(self.entries)}
        return self._assign(envs, [place[key] for key in chosen])

    def _assign(self, envs: Sequence[int], worlds: Sequence[int]) -> np.ndarray:
        """Assign worlds to environments and drop unused worlds; return the packs that changed."""
        index = np.array(self.index)
        index[list(envs)] = worlds
        packs = np.unique(self.env_pack[list(envs)])

        # Lanes without an environment repeat the one before them.
        self.lane_world[self.env_pack, self.env_lane] = index
        filled = np.zeros(self.lane_world.shape, bool)
        filled[self.env_pack, self.env_lane] = True
        last = np.maximum.accumulate(np.where(filled, np.arange(self.lanes), 0), axis=1)
        self.lane_world = np.take_along_axis(self.lane_world, last, axis=1)

        # Forget worlds that no environment has any more.
        used, inverse = np.unique(index, return_inverse=True)
        self.lane_world = np.searchsorted(used, self.lane_world)
        self.index = inverse.tolist()
        groups = self.groups
        for number, frame in enumerate(self.frames):
            frame.keep(np.isin(np.flatnonzero(groups == number), used))
        self.entries = [self.entries[k] for k in used]
        return packs

    def frame_of_envs(self) -> np.ndarray:
        """Return the index of each environment's frame in ``compiled``, int ``[num_envs]``."""
        return self.groups[self.index]

    def tables(self, packs: np.ndarray | None = None) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Make the tables of ``packs`` (None: all), without duplicates; return the index of each pack's tables too."""
        packs = np.arange(len(self.pack_group)) if packs is None else packs
        groups = np.asarray(self.pack_group)[packs]
        if self.arithmetic == "exact":
            kinds, which = np.unique(groups, return_inverse=True)
            tables = exact_tables([self.compiled[kind] for kind in kinds], self.lanes)
            names = [[body.name for body in self.compiled[kind].bodies] for kind in kinds]
            tables["frame"] = kinds.astype(np.int32)
        else:
            rows = np.concatenate([groups[:, None], self.lane_world[packs]], axis=1)
            kinds, which = np.unique(rows, axis=0, return_inverse=True)
            parts = []
            names = []
            for number, frame in enumerate(self.frames):
                mine = kinds[kinds[:, 0] == number, 1:]
                if len(mine):
                    part = frame.tables((np.cumsum(self.groups == number) - 1)[mine])
                    part["frame"] = np.full(len(mine), number, np.int32)
                    parts.append(part)
                    names += [frame.object_names] * len(mine)
            tables = join(parts)
            empty = no_order()
            tables |= {name: np.repeat(np.asarray(value)[None], len(kinds), axis=0) for name, value in empty.items()}
        if self.layout == "group":
            tables |= by_level(tables)
        tables["object_range"] = self._spans(tables.pop("object_points"), names)
        return tables, which.reshape(-1)

    def _spans(self, counts: np.ndarray, names: list[list[str]]) -> np.ndarray:
        """Return the first and last-plus-one point of each object, int ``[tables, objects, lanes, 2]``."""
        stop = np.cumsum(counts, axis=1)
        start = stop - counts
        spans = np.zeros((len(counts), len(self.object_names), counts.shape[2], 2), np.int32)
        column = {name: k for k, name in enumerate(self.object_names)}
        for row, own in enumerate(names):
            at = [column[name] for name in own]
            spans[row, at, :, 0] = start[row, : len(own)]
            spans[row, at, :, 1] = stop[row, : len(own)]
        return spans

    def frame_tables(self) -> dict[str, np.ndarray]:
        """Return the terrain tables of all frames; empty in exact arithmetic (see :meth:`tables`)."""
        names = ("fixed_at", "terrain", "terrain_side", "terrain_box")
        parts = [{name: frame.arrays[name][None] for name in names} for frame in self.frames]
        return join(parts) if parts else {}

    def capacities(self) -> dict[str, int]:
        """Return the array sizes, by name, that any bodies up to ``grid`` need; empty without ``grid``."""
        if self.grid is None:
            return {}
        most = [capacities(frame, *self.grid, self.cut) for frame in self.frames]
        return {name: max(part[name] for part in most) for name in most[0]}
