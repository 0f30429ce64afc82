"""Simulation of many worlds in parallel."""

from __future__ import annotations

import itertools
import os
import weakref
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, NoReturn, cast

import numpy as np
import torch
import warp as wp

from warpvox.batch.arrays import Buffers, allocate_buffers, put_tables
from warpvox.batch.objects import CompiledWorlds, Objects
from warpvox.batch.options import SimKeywords, SimOptions
from warpvox.batch.packs import Actuators, Batch, group
from warpvox.checks import check_choice, check_mask
from warpvox.compile import mesh
from warpvox.errors import ActionError, SimulationError, counted
from warpvox.kernels import reset as reset_stage, step as step_stage
from warpvox.kernels.state import DIVERGED, OVERFLOW, STALE, STOPPED
from warpvox.sensors import Recorded, Sensing
from warpvox.types import ACTION_HIGH, ACTION_LOW
from warpvox.world import World

if TYPE_CHECKING:
    from typing_extensions import Unpack

_NUMBERS = {torch.int64, torch.int32, torch.int16, torch.int8}
_NUMBERS |= {torch.float32, torch.float64, torch.float16, torch.bfloat16}
"""Types that actions may have."""

_living: weakref.WeakSet[Simulation] = weakref.WeakSet()


if hasattr(os, "register_at_fork"):  # a child has no threads but the one that forked
    os.register_at_fork(after_in_child=lambda: [sim.begin_threads() for sim in list(_living)])


class Simulation(Sensing):
    """Many worlds, one per environment, stepped in parallel.

    Args:
        worlds: one :class:`World` per environment; they are copied.
        sim: how they are computed; its fields may also be given by name: ``device="cpu"``.
        loose: names of objects that :meth:`shift` may move; terrain among them is not merged with the rest.
        action_range: to what actions are clipped.
        options: fields of ``sim``.

    Attributes:
        options: as chosen; ``layout``, ``threads``, ``physics``, ``arithmetic``, ``dtype``, ``device``: what is in use.
        grid: rows and columns up to which bodies may be exchanged, or None.
        world_numbers: long ``[num_envs]``: equal for equal worlds, also in other simulations and processes.
        slot: long ``[num_envs]``: where an environment lies in arrays ``[pack, lane]``, flattened.
        action_buffer: ``[num_envs, num_actions]``: the tensor that :meth:`advance` reads actions from, not a copy.

    Positions are in simulator units (0.1 a voxel), velocities in those units per inner time (a control step lasts
    ``physics.substeps * physics.dt``, 30 x 1e-4). Tensors that methods return are fresh; they never alias the
    simulator's buffers.

    Raises:
        SimulationError, DeviceError, ConfigError: what was asked for cannot be built.
    """

    def __init__(
        self,
        worlds: Sequence[World],
        sim: SimOptions | None = None,
        *,
        loose: Sequence[str] = (),
        action_range: tuple[float, float] = (ACTION_LOW, ACTION_HIGH),
        **options: Unpack[SimKeywords],
    ):
        if not isinstance(worlds, Sequence) or not worlds or not all(isinstance(world, World) for world in worlds):
            raise SimulationError(f"Simulation needs a list of one World or more, got {worlds!r:.80}.")
        self.options = SimOptions.of(sim, options, Simulation.__init__).resolved(len(worlds))
        if not isinstance(loose, Sequence) or isinstance(loose, str) or not all(isinstance(one, str) for one in loose):
            raise SimulationError(f"loose must be a list of names of objects, got {loose!r:.80}.")
        try:
            low, high = (float(bound) for bound in action_range)
        except (TypeError, ValueError, OverflowError):
            low = 1.0
            high = 0.0
        if not low <= high:  # NaN, too
            raise SimulationError(f"action_range must be two numbers low <= high, got {action_range!r:.80}.")
        self.device = self.options.device
        self.physics = self.options.physics
        self.grid = self.options.grid
        self.arithmetic = self.options.arithmetic
        self.threads = self.options.threads
        self.dtype: torch.dtype = getattr(torch, self.options.dtype)

        # Packs and their buffers; the group layout may have no room for these worlds
        different, index = group(worlds)
        self.layout = self.options.layout
        self._batch = Batch(different, index, self.options, tuple(loose), self.layout)
        state = allocate_buffers(self._batch, self.options.dtype)
        if state is None:
            self.layout = "lanes"
            self._batch = Batch(different, index, self.options, tuple(loose), self.layout)
            state = allocate_buffers(self._batch, self.options.dtype)
        self._state = cast(Buffers, state)

        # Worlds, objects and actions
        self.designs = CompiledWorlds(self._batch)
        self.num_envs = len(worlds)
        self.design_index = torch.tensor(index, dtype=torch.long, device=self.device)
        self.num_actions = self._state.sizes["action"]
        self._objects = Objects(self._batch, self._state)
        self.object_names = self._objects.names
        self.loose = tuple(loose)
        self._loose = self._objects.loose_points(self.loose)
        self.action_range = low, high
        self.action_buffer = torch.zeros((self.num_envs, self.num_actions), dtype=self.dtype, device=self.device)
        self._action_array = wp.from_torch(self.action_buffer)
        self._action_places: dict[str, torch.Tensor] = {}

        # Launches, and views on the buffers
        self.begin_threads()
        _living.add(self)
        self._launches: list[Recorded] = []
        self._take: Recorded | None = None
        self._views = {name: wp.to_torch(self._state.arrays[name]) for name in (*STATE_FIELDS, "drift")}
        self._env = tuple(wp.to_torch(array).long() for array in (self._state.env_pack, self._state.env_lane))
        self.slot = self._env[0] * self._state.lanes + self._env[1]
        self._begin_sensing()
        self._follow_worlds()

        # The buffers begin as after a reset. Lanes that belong to no environment stay frozen.
        self._views["frozen"].fill_(1)
        self._views["frozen"].view(-1)[self.slot] = 0

    def __repr__(self) -> str:
        how = f"{self.arithmetic}, {self.options.dtype}, {self.device}"
        return f"Simulation({counted(self.num_envs, 'environments')}, {how})"

    def __reduce_ex__(self, protocol: object) -> NoReturn:
        raise SimulationError("A simulation cannot be copied or pickled: another's set_state() takes its state().")

    def step(self, actions) -> None:
        """Do one control step in every environment that is not frozen.

        Args:
            actions: torch or numpy ``[num_envs, num_actions]``, target lengths of the actuators in units of their
                rest length, clipped to ``action_range``; columns beyond a design's own actuators are ignored.

        Raises:
            ActionError: wrong shape; on the CPU also values that are not finite (on CUDA such an environment
                becomes unstable, because looking at them would wait for the device).
        """
        self.take(actions)
        self.advance()

    def take(self, actions: object, mask: torch.Tensor | None = None) -> None:
        """Check the actions and store them for :meth:`advance`; the first half of :meth:`step`.

        Where ``mask`` (bool ``[num_envs]``) is False, those taken before remain; None: all are taken.
        """
        actions = checked_actions(actions, (self.num_envs, self.num_actions))
        if actions.dtype == torch.float64 and self.dtype != torch.float64:
            most = torch.finfo(self.dtype).max
            actions = actions.clamp(-most, most)  # beyond it a finite number would become infinite
        actions = actions.detach()  # or the buffer would remember all that they were computed from
        if mask is not None:
            actions = torch.where(mask[:, None], actions.to(self.action_buffer), self.action_buffer)
        self.action_buffer.copy_(actions)

    @property
    def actions(self) -> torch.Tensor:
        """Actions last passed to :meth:`step`, unclipped: ``[num_envs, num_actions]``, a copy."""
        return self.action_buffer.clone()

    def advance(self) -> None:
        """Step the physics with the actions stored by :meth:`take`; the second half of :meth:`step`.

        On CUDA it goes to torch's current stream, and a graph may capture it.
        """
        if not self._launches:
            self._launches = self.record_shares(partial(step_stage.record_step, self._state, self.physics.substeps))
        self.place_actions()
        self.run(self._launches)

    def place_actions(self) -> None:
        """Clip the stored actions and copy them to the kernels' arrays, as :meth:`advance` does."""
        if self._take is None:
            self._take = step_stage.record_actions(self._state, self._action_array, *self.action_range)
        if self.num_actions:
            self._take.launch()

    def run(self, launches: Sequence[Recorded]) -> None:
        """Launch recorded kernels that move points, in parallel threads, each for a share of the environments."""
        jobs = [self._pool.submit(launch.launch) for launch in launches[1:]]
        launches[0].launch()
        for job in jobs:
            job.result()
        self._centres_are_new = False

    def begin_threads(self) -> None:
        """Start the worker threads of :meth:`run`; a forked process starts its own."""
        self._pool = ThreadPoolExecutor(self.threads)

    def record_shares(self, record: Callable[[int, int], Recorded]) -> list[Recorded]:
        """Record a kernel launch for each thread, over an equal share of the environments.

        On the CPU a launch runs on one core and lets go of the GIL: each thread gets a share of the packs.
        """
        packs = self._state.packs
        count = min(self.threads, packs) if self.device == "cpu" else 1
        cuts = [packs * k // count for k in range(count + 1)]
        return [record(begin, end - begin) for begin, end in itertools.pairwise(cuts)]

    def reset(self, mask: torch.Tensor | None = None) -> None:
        """Reset environments to time 0 and unfreeze them; ``mask``: bool ``[num_envs]``; None means all."""
        reset_stage.launch(self._state, wp.from_torch(self._mask_or_all(mask).contiguous()))
        self._centres_are_new = False

    def shift(self, cells: torch.Tensor, mask: torch.Tensor | None = None) -> None:
        """Move all ``loose`` objects to their initial position plus ``cells``, at rest.

        Meant for the beginning of an episode. Overlaps with other objects are not checked.

        Args:
            cells: integers ``[num_envs, 2]``, to the right and up, from their places in the world.
            mask: bool ``[num_envs]``, the environments to change; None means all.
        """
        mask = self._mask_or_all(mask).contiguous()
        cells = torch.as_tensor(cells, device=self.device)
        if tuple(cells.shape) != (self.num_envs, 2) or cells.dtype.is_floating_point:
            raise SimulationError(f"Shifts must be integers [{self.num_envs}, 2], got {list(cells.shape)}.")
        arrays = (wp.from_torch(tensor) for tensor in (mask, cells.long().contiguous(), self._loose))
        reset_stage.launch_shift(self._state, *arrays)
        self.invalidate()

    def invalidate(self) -> None:
        """Discard possible contacts and cached centres of mass; call this after writing to points."""
        self._views["drift"].fill_(STALE)
        self._centres_are_new = False

    @property
    def buffers(self) -> Buffers:
        """Arrays of the kernels, and each environment's pack and lane, for code that launches kernels."""
        return self._state

    def array(self, name: str) -> torch.Tensor:
        """Return an array of :mod:`warpvox.kernels.state` without copying; after writing, call :meth:`invalidate`."""
        check_choice("The name of an array", name, self._state.arrays, SimulationError)
        return wp.to_torch(self._state.arrays[name])

    def set_frozen(self, mask: torch.Tensor) -> None:
        """Freeze environments where ``mask`` is True and unfreeze the others; frozen ones keep state and time.

        Args:
            mask: bool ``[num_envs]``.
        """
        self._views["frozen"].view(-1)[self.slot] = self._check_mask(mask).to(torch.int32)

    def _check_mask(self, mask) -> torch.Tensor:
        return check_mask(mask, self.design_index, SimulationError)

    def _mask_or_all(self, mask: torch.Tensor | None) -> torch.Tensor:
        """Return ``mask`` after checking it, or a mask of all environments for None."""
        return torch.ones_like(self.design_index, dtype=torch.bool) if mask is None else self._check_mask(mask)

    def _by_environment(self, name: str) -> torch.Tensor:
        """Gather a kernel array ``[pack, lane]`` by environment, ``[num_envs]``."""
        return self._views[name].view(-1).index_select(0, self.slot)

    @property
    def frozen(self) -> torch.Tensor:
        """Mask of environments that steps skip, bool [num_envs]."""
        return self._by_environment("frozen") == 1

    @property
    def time(self) -> torch.Tensor:
        """Number of completed control steps since the reset, int64 [num_envs]."""
        return self._by_environment("time").long()

    @property
    def unstable(self) -> torch.Tensor:
        """Mask of environments whose last step was undone after self-folding or divergence, bool [num_envs]."""
        return (self._by_environment("status") & STOPPED) != 0

    @property
    def diverged(self) -> torch.Tensor:
        """Mask of environments whose last step diverged (a subset of :attr:`unstable`), bool [num_envs].

        A step diverges with values that are not finite, speeds above 1e4 (units of inner time) or coordinates beyond
        1e6; see :mod:`warpvox.kernels.state`. The step is undone; if it began with non-finite values, which only
        :meth:`set_state` can cause, the environment is reset instead.
        """
        return (self._by_environment("status") & DIVERGED) != 0

    @property
    def overflow(self) -> torch.Tensor:
        """Mask of environments whose last step ignored contacts for lack of room, bool [num_envs]."""
        return (self._by_environment("status") & OVERFLOW) != 0

    @property
    def worlds(self) -> list[World]:
        """Distinct worlds; ``design_index`` maps environments to them."""
        return [entry.world for entry in self._batch.entries]

    @property
    def num_designs(self) -> int:
        """Number of distinct worlds."""
        return len(self._batch.entries)

    @property
    def action_mask(self) -> torch.Tensor:
        """Mask of the real actions in each distinct world, bool [num_designs, num_actions]."""
        counts = [sum(count for _, count in entry.actuators) for entry in self._batch.entries]
        return torch.arange(self.num_actions, device=self.device) < torch.tensor(counts, device=self.device)[:, None]

    @property
    def action_columns(self) -> list[dict[str, slice]]:
        """Columns of each robot's actions in every distinct world, ``{name: slice}``."""
        columns: dict[Actuators, dict[str, slice]] = {}  # designs of one size have one entry
        for sizes in {entry.actuators for entry in self._batch.entries}:
            columns[sizes] = {}
            start = 0
            for name, count in sizes:
                columns[sizes][name] = slice(start, start + count)
                start += count
        return [columns[entry.actuators] for entry in self._batch.entries]

    def robot_actions(self, name: str) -> torch.Tensor:
        """Return a robot's clipped actions of the last step, [num_envs, num_actions], padded at the end.

        Behind its own, and before the first step of an episode, entries are 1: at rest.
        """
        if name not in self._action_places:
            self._action_places[name] = self._action_ranges(name)
        first, end = self._action_places[name].T[..., None]
        column = first + torch.arange(self.num_actions, device=self.device)
        known = (column < end) & (self.time > 0)[:, None]
        own = self.action_buffer.clamp(*self.action_range).gather(1, column.clamp(max=self.num_actions - 1))
        return own.masked_fill(~known, 1.0)

    def _action_ranges(self, name: str) -> torch.Tensor:
        """Return first and last-plus-one column of a robot's actions, long [num_envs, 2]."""
        self._objects.index(name)
        places = [columns.get(name, slice(0, 0)) for columns in self.action_columns]
        return torch.tensor([(at.start, at.stop) for at in places], device=self.device)[self.design_index]

    def num_points(self, name: str) -> int:
        """Return the number of points of an object, the maximum over all designs."""
        self._objects.index(name)
        return self._objects.num_points[name]

    def point_mask(self, name: str) -> torch.Tensor:
        """Return a mask of an object's real points in each design, bool [num_designs, points]."""
        return self._objects.point_mask(name)

    def voxel_corners(self, name: str, design: int = 0) -> np.ndarray:
        """Return point indices of each voxel's corners, clockwise from top left: int32 [voxels, 4]."""
        self._objects.index(name)
        source = self.worlds[design].objects.get(name)
        if source is None:
            raise SimulationError(f"Design {design} has no object named {name!r}.")
        # the object alone: the world's terrain is many times as large
        return np.array(list(mesh(source, self.physics).corners.values()), dtype=np.int32)

    def state(self) -> dict[str, torch.Tensor]:
        """Return the full state, one row per environment, for :meth:`set_state`.

        Positions and velocities list the points as observations do, x and y alternately, padded with 0.
        """
        return self._read(slice(None))

    def _read(self, envs: torch.Tensor | slice) -> dict[str, torch.Tensor]:
        """Return the :meth:`state` of some environments."""
        pack, lane = (index[envs] for index in self._env)
        state = {}
        for name in STATE_FIELDS:
            view = self._views[name]
            if view.ndim == 2:
                state[name] = view[pack, lane]
            else:
                values = view[pack[:, None], self._rows[envs], lane[:, None]]
                state[name] = values.masked_fill(~self._has_row[envs], 0.0)
        return state

    @property
    def rows(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Row in the kernels' arrays of each column of :meth:`state` positions, and a mask of real columns.

        Long and bool ``[num_envs, columns]``; a column is the x or the y of a point, or padding.
        """
        return self._rows, self._has_row

    def rows_of(self, name: str) -> torch.Tensor:
        """Return which columns of the positions in :meth:`state` belong to an object, bool ``[num_envs, columns]``."""
        points = self._objects.point_range[:, self._objects.index(name), :, None]
        point = torch.arange(self._rows.shape[1], device=self.device) // 2
        return (point >= points[:, 0]) & (point < points[:, 1])

    def set_state(self, state: dict[str, torch.Tensor]) -> None:
        """Restore a :meth:`state` of the same worlds, possibly assembled from rows of other states.

        Rows may be longer or shorter than this simulation's by what is only padding: the most points of a world
        depend on which worlds there are.

        Raises:
            SimulationError: fields or shapes that are not this simulation's.
        """
        least = 2 * int(self._objects.total.max())
        for name in STATE_FIELDS:
            view = self._views[name]
            given = state.get(name) if isinstance(state, Mapping) else None
            if not (
                isinstance(given, torch.Tensor)
                and given.dtype == view.dtype
                and given.ndim == view.ndim - 1
                and len(given) == self.num_envs
                and (given.ndim == 1 or given.shape[1] >= least)
            ):
                kind = str(view.dtype).removeprefix("torch.")
                columns = f", {least} or more" if view.ndim == 3 else ""
                expected = f"{kind} [{self.num_envs}{columns}]"
                got = f"{given.dtype} {list(given.shape)}" if isinstance(given, torch.Tensor) else f"{given!r:.60}"
                raise SimulationError(
                    f"The state's {name!r} is not that of this simulation of {self.num_envs} environments: expected"
                    f" {expected}, got {got.removeprefix('torch.')}."
                )
        self._write(state, torch.arange(self.num_envs, device=self.device))

    def _write(self, state: dict[str, torch.Tensor], envs: torch.Tensor) -> None:
        """Write the rows of ``state`` into the environments ``envs``."""
        pack, lane = (index[envs] for index in self._env)
        rows = self._rows[envs]
        real = self._has_row[envs]
        env, column = real.nonzero(as_tuple=True)
        place = pack[env], rows[env, column], lane[env]
        for name in STATE_FIELDS:
            view = self._views[name]
            values = state[name]
            if view.ndim == 2:
                view[pack, lane] = values
            else:
                view[place] = values[env, column]
        reset_stage.launch_follow(self._state)
        self.invalidate()

    def set_worlds(self, worlds: Sequence[World], mask: torch.Tensor) -> None:
        """Replace the worlds of environments by worlds with other robot bodies, and reset these environments.

        No array moves and no kernel is compiled. ``worlds``, ``designs`` and ``design_index`` are updated.

        Args:
            worlds: one for each environment of the mask.
            mask: bool ``[num_envs]``.

        Raises:
            SimulationError: the simulation was made without ``grid``, or a world that is not of this kind.
        """
        mask = self._check_mask(mask)
        envs = mask.nonzero()[:, 0]
        if len(worlds) != len(envs):
            raise SimulationError(f"{len(envs)} environments need a world each, got {len(worlds)}.")
        if not len(envs):
            return

        # The other environments of the same packs, whose tables may change, keep their state.
        packs = self._batch.replace(envs.tolist(), worlds)
        touched = torch.isin(self._env[0], torch.as_tensor(packs, device=self.device))
        others = (touched & ~mask).nonzero()[:, 0]
        before = self._read(others)

        # Tables
        tables, which = self._batch.tables(packs)
        put_tables(self._state, {name: values[which] for name, values in tables.items()}, packs)
        # Also lanes without an environment: if their points moved, all lanes' contact candidates would be made again.
        self._views["pos"][packs] = self.array("rest_pos")[packs]

        # What follows from them
        self._objects.refresh()
        self._loose.copy_(self._objects.loose_points(self.loose))  # in place: a captured step may read it
        self._follow_worlds()
        self.reset(touched)
        self._write(before, others)

    def _follow_worlds(self) -> None:
        """Update caches and index tensors after environments got other worlds."""
        self.designs.forget()
        self.design_index.copy_(torch.as_tensor(self._batch.index))
        numbers = np.array([int.from_bytes(entry.key[:8], "little", signed=True) for entry in self._batch.entries])
        self.world_numbers = torch.as_tensor(numbers[self._batch.index], device=self.device)

        # Where state and actions lie
        for buffer in self.sensing_buffers:  # entries of points that there are no more
            buffer.zero_()
        rows = self._objects.rows
        self._rows = torch.stack([2 * rows, 2 * rows + 1], dim=-1).flatten(1)
        count = torch.arange(rows.shape[1], device=rows.device) < self._objects.total[:, None]
        self._has_row = count.repeat_interleave(2, dim=1)
        for name, places in self._action_places.items():
            places.copy_(self._action_ranges(name))


STATE_FIELDS = ("pos", "vel", "true_vel", "frozen", "status", "time")


def checked_actions(
    actions: object, shape: tuple[int, int], device: str | None = None, counts: torch.Tensor | None = None
) -> torch.Tensor:
    """Validate ``actions`` and return a tensor ``[num_envs, num_actions]``, on ``device`` if given.

    Raises:
        ActionError: they are no plain numbers of this ``shape``; on the CPU also values that are not finite, where they
            count (bool of this shape; None: everywhere).
    """
    try:
        actions = torch.as_tensor(actions, device=device)
    except Exception as error:  # `as_tensor` may raise anything for what is no array
        raise ActionError(f"Actions must be a tensor or array of numbers: {str(error)[:200]}.") from None
    if tuple(actions.shape) != shape:
        got = list(actions.shape)
        raise ActionError(f"Actions must have the shape {list(shape)} [num_envs, num_actions], got {got}.")
    if actions.dtype not in _NUMBERS or actions.layout is not torch.strided or actions.device.type == "meta":
        got = f"{actions.dtype}, {actions.layout} on {actions.device.type}"
        raise ActionError(f"Actions must be plain numbers, got {got}.")
    if actions.device.type == "cpu":
        fine = torch.isfinite(actions) if counts is None else torch.isfinite(actions) | ~counts
        if not bool(fine.all()):
            bad = int((~fine).nonzero()[0, 0])
            raise ActionError(f"Actions must be finite numbers; environment {bad} has NaN or infinity.")
    return actions
