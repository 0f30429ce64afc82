"""Simulation: many worlds stepped at once."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
import warp as wp

from warpvox.compile import Body, compile_world
from warpvox.errors import ActionError, DeviceError, SimulationError, did_you_mean, listing
from warpvox.kernels import reset as reset_stage
from warpvox.kernels import sensing
from warpvox.kernels import step as step_stage
from warpvox.kernels.reset import STALE
from warpvox.kernels.state import DIVERGED, OVERFLOW, UNSTABLE
from warpvox.layout import choose_lanes, choose_threads, group, layout, resolve_arithmetic
from warpvox.startup import start_warp
from warpvox.types import ACTION_HIGH, ACTION_LOW, SIGHT, VOXEL, Physics
from warpvox.world import World

__all__ = ["STATE_FIELDS", "Simulation", "resolve_device"]

NUMBERS = {
    torch.float32,
    torch.float64,
    torch.float16,
    torch.bfloat16,
    torch.int64,
    torch.int32,
    torch.int16,
    torch.int8,
}
"""Types that actions may have."""
DTYPES = {"float32": torch.float32, "float64": torch.float64}
_STOPPED, _OVERFLOW = int(UNSTABLE | DIVERGED), int(OVERFLOW)


class Simulation:
    """Worlds stepped together, one environment each; equal worlds share one compiled design.

    Args:
        worlds: one :class:`World` per environment.
        device: 'auto' (CUDA where there is one), 'cpu', 'cuda' or 'cuda:<index>'.
        physics: a preset's name or a :class:`Physics`.
        dtype: precision of the springs and of what is returned: 'float32' or 'float64'. State and contacts are float64
            in both.
        lanes: environments that one CPU thread advances at once (1, 8, 16 or 32); None chooses.
        threads: CPU threads; None takes all cores. Also an attribute.
        loose: names of objects that :meth:`shift` may move; terrain among them is not merged with the rest.
        action_range: to what actions are clipped.
        arithmetic: 'fast', or 'exact' (float64 only), which repeats the released simulator bit for bit: the same
            physics, every sum in its order. None: 'fast' in float32, 'exact' in float64.

    Positions are in simulator units (0.1 a voxel), velocities in those units per inner time (a control step lasts
    ``physics.substeps * physics.dt``, 30 x 1e-4). Tensors that methods return are fresh; they never alias the
    simulator's buffers.

    Raises:
        SimulationError, DeviceError, ConfigError: what was asked for cannot be built.
    """

    def __init__(
        self,
        worlds: Sequence[World],
        device: str = "auto",
        physics: str | Physics = "evogym",
        dtype: str = "float32",
        lanes: int | None = None,
        threads: int | None = None,
        loose: Sequence[str] = (),
        action_range: tuple[float, float] = (ACTION_LOW, ACTION_HIGH),
        arithmetic: str | None = None,
    ):
        if not isinstance(worlds, Sequence) or not worlds or not all(isinstance(world, World) for world in worlds):
            raise SimulationError(f"Simulation needs a list of one World or more, got {worlds!r:.80}.")
        if not isinstance(dtype, str) or dtype not in DTYPES:
            raise SimulationError(f"dtype must be 'float32' or 'float64', got {dtype!r:.80}.")
        self.arithmetic = resolve_arithmetic(arithmetic, dtype)
        _check_names(loose)
        low, high = _check_range(action_range)
        self.device = resolve_device(device)
        self.physics = physics if isinstance(physics, Physics) else Physics.preset(physics)
        self.dtype = DTYPES[dtype]
        index = group(worlds)
        self.worlds = [worlds[index.index(d)] for d in range(max(index) + 1)]
        self.designs = [compile_world(world, self.physics, loose) for world in self.worlds]
        self.num_envs, self.num_designs = len(worlds), len(self.worlds)
        self.design_index = torch.tensor(index, dtype=torch.long, device=self.device)
        lanes = choose_lanes(index, lanes, self.device)
        self._state = layout(self.designs, index, self.physics, self.arithmetic, dtype, lanes, self.device)
        self.num_actions = max(sum(b.source.num_actuators for b in design.bodies) for design in self.designs)
        self._name_objects()
        self.loose = tuple(loose)
        self._loose = _loose_points(self, self.loose)
        self.threads = choose_threads(threads)
        self._pool = ThreadPoolExecutor(self.threads)
        self._shares: list[wp.Launch] = []
        self._sensors: dict[tuple, tuple[wp.Launch, list[torch.Tensor]]] = {}
        self._views = {name: wp.to_torch(self._state.arrays[name]) for name in (*STATE_FIELDS, "drift")}
        self._env = (_torch(self._state.env_pack), _torch(self._state.env_lane))
        self._slot = self._env[0] * self._state.lanes + self._env[1]
        self._action_range = low, high
        self._actions = torch.zeros((self.num_envs, self.num_actions), dtype=self.dtype, device=self.device)
        self._action_array = wp.from_torch(self._actions)
        self._graph = None
        self._scans: dict[tuple, tuple] = {}
        self._fixed: dict[tuple[str, bool], tuple[torch.Tensor, torch.Tensor]] = {}
        self._centres_are_new = False
        self._views["frozen"].fill_(1)  # lanes that belong to no environment stay so
        self.reset()

    # ---------------------------------------------------------------- stepping

    def step(self, actions) -> None:
        """One control step of every environment that is not frozen.

        Args:
            actions: torch or numpy ``[num_envs, num_actions]``, goal lengths of the actuators in units of their
                rest length, clipped to ``action_range``; columns beyond a design's own actuators are ignored.

        Raises:
            ActionError: wrong shape; on the CPU also values that are not finite (on CUDA such an environment
                becomes unstable, because looking at them would wait for the device).
        """
        self.take(actions)
        self.advance()

    def take(self, actions) -> None:
        """The first half of :meth:`step`: check the actions and keep them for :meth:`advance`."""
        try:
            actions = torch.as_tensor(actions)
        except Exception as error:  # whatever an object that is no array says when it is asked for numbers
            raise ActionError(f"Actions must be a tensor or array of numbers: {str(error)[:200]}.") from None
        if tuple(actions.shape) != tuple(self._actions.shape):
            expected = list(self._actions.shape)
            raise ActionError(
                f"Actions must have the shape {expected} [num_envs, num_actions], got {list(actions.shape)}."
            )
        if actions.dtype not in NUMBERS or actions.layout is not torch.strided or actions.device.type == "meta":
            raise ActionError(
                f"Actions must be plain numbers, got {actions.dtype}, {actions.layout} on {actions.device.type}."
            )
        if actions.device.type == "cpu" and not bool(torch.isfinite(actions).all()):
            bad = int((~torch.isfinite(actions)).nonzero()[0, 0])
            raise ActionError(f"Actions must be finite numbers; environment {bad} has NaN or infinity.")
        self._actions.copy_(actions)

    @property
    def actions(self) -> torch.Tensor:
        """``[num_envs, num_actions]``: the actions taken last, as they were given."""
        return self._actions.clone()

    def advance(self) -> None:
        """The second half of :meth:`step`; on CUDA it can be part of a graph that is being captured."""
        if self.device == "cpu" or torch.cuda.is_current_stream_capturing():
            self._control_step()
        else:
            self._replay()
        self._centres_are_new = False

    def _control_step(self) -> None:
        if not self._shares:
            self._shares = self._record_shares()
            self._take = step_stage.record_actions(self._state, self._action_array, *self._action_range)
        if self.num_actions:
            self._take.launch()
        jobs = [self._pool.submit(share.launch) for share in self._shares[1:]]
        self._shares[0].launch()
        for job in jobs:
            job.result()

    def _record_shares(self) -> list[wp.Launch]:
        """On the CPU a launch runs on one core and lets go of the GIL: each thread gets a share of the packs."""
        packs = self._state.packs
        count = min(self.threads, packs) if self.device == "cpu" else 1
        cuts = [packs * k // count for k in range(count + 1)]
        substeps = self.physics.substeps
        return [step_stage.record(self._state, substeps, begin, end - begin) for begin, end in itertools.pairwise(cuts)]

    def _replay(self) -> None:
        """The control step as a CUDA graph, captured on first use; arrays never move afterwards."""
        with wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(self.device))):
            if self._graph is None:
                self._control_step()  # loads the modules; this first step is not captured
                with wp.ScopedCapture(device=self.device) as capture:
                    self._control_step()
                self._graph = capture.graph
            else:
                wp.capture_launch(self._graph)

    def reset(self, mask: torch.Tensor | None = None) -> None:
        """Put environments back to time 0 and thaw them.

        Args:
            mask: bool ``[num_envs]``; None means all.
        """
        if mask is None:
            mask = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
        mask = self._check_mask(mask)
        reset_stage.launch(self._state, wp.from_torch(mask.contiguous()))
        self._centres_are_new = False

    def shift(self, cells: torch.Tensor, mask: torch.Tensor | None = None) -> None:
        """Put all ``loose`` objects where they would begin, had the world placed them ``cells`` further, and at rest.

        Meant for the beginning of an episode: whether they then overlap other objects is not looked at.

        Args:
            cells: whole numbers ``[num_envs, 2]``, to the right and up, from their places in the world.
            mask: bool ``[num_envs]``, the environments to change; None means all.
        """
        mask = torch.ones(self.num_envs, dtype=torch.bool, device=self.device) if mask is None else mask
        mask = self._check_mask(mask)[:, None]
        cells = torch.as_tensor(cells, device=self.device)
        if tuple(cells.shape) != (self.num_envs, 2) or cells.dtype.is_floating_point:
            raise SimulationError(f"Shifts must be whole numbers [{self.num_envs}, 2], got {list(cells.shape)}.")
        point, corner, height, inside = (table[self.design_index] for table in self._loose)
        # The expressions with which a world is compiled, one operation at a time: the last bit matters.
        x, y = (corner + cells[:, None]).double().unbind(-1)
        across, down = inside.double().unbind(-1)
        x = x * VOXEL + across * VOXEL
        y = (y * VOXEL + height.double() * VOXEL) - down * VOXEL
        pack, lane = (index[:, None] for index in self._env)
        for row, values in ((2 * point, x), (2 * point + 1, y)):
            for name in ("pos", "vel", "true_vel"):
                view = self._views[name]
                old = view[pack, row, lane]
                new = torch.where(mask, values, old) if name == "pos" else old.masked_fill(mask, 0.0)
                view.index_put_((pack, row, lane), new)
        self.invalidate()

    def invalidate(self) -> None:
        """Drop what is derived from the points (contact candidates, centres): for code that has written to them."""
        self._views["drift"].fill_(STALE)
        self._centres_are_new = False

    def set_frozen(self, mask: torch.Tensor) -> None:
        """Freeze (True) or thaw environments: a frozen one keeps its state and its time.

        Args:
            mask: bool ``[num_envs]``.
        """
        self._views["frozen"].view(-1)[self._slot] = self._check_mask(mask).to(torch.int32)

    def _check_mask(self, mask) -> torch.Tensor:
        mask = torch.as_tensor(mask, device=self.device)
        if tuple(mask.shape) != (self.num_envs,) or mask.dtype != torch.bool:
            raise SimulationError(f"A mask must be bool [{self.num_envs}], got {mask.dtype} {list(mask.shape)}.")
        return mask

    # ------------------------------------------------------------------ status

    def _of_environments(self, name: str) -> torch.Tensor:
        return self._views[name].view(-1).index_select(0, self._slot)

    @property
    def frozen(self) -> torch.Tensor:
        """bool [num_envs]: environments that keep their state."""
        return self._of_environments("frozen") == 1

    @property
    def time(self) -> torch.Tensor:
        """int64 [num_envs]: complete control steps since the reset."""
        return self._of_environments("time").long()

    @property
    def unstable(self) -> torch.Tensor:
        """bool [num_envs]: the last step was stopped (self-folding or bad numbers) and undone."""
        return (self._of_environments("status") & _STOPPED) != 0

    @property
    def diverged(self) -> torch.Tensor:
        """bool [num_envs]: the last step was stopped because of bad numbers; such an environment is unstable, too.

        Bad are numbers that are not finite, speeds above 1e4 (units of inner time) and coordinates beyond 1e6; see
        :mod:`warpvox.kernels.guard`. The step is undone. Had the step begun with bad numbers, which only
        :meth:`set_state` can bring about, the environment stands at time 0 and at rest instead.
        """
        return (self._of_environments("status") & int(DIVERGED)) != 0

    @property
    def overflow(self) -> torch.Tensor:
        """bool [num_envs]: the last step met more contact candidates than there is room for, and left some out."""
        return (self._of_environments("status") & _OVERFLOW) != 0

    # ----------------------------------------------------------------- objects

    def _name_objects(self) -> None:
        names = {body.name: body.source.is_robot for design in self.designs for body in design.bodies + design.statics}
        self.object_names = sorted(names, key=lambda name: (not names[name], name))
        ranges = np.zeros((self.num_designs, len(self.object_names), 2), dtype=np.int32)
        for d, design in enumerate(self.designs):
            for body in design.bodies:
                begin = body.first_point
                ranges[d, self.object_names.index(body.name)] = begin, begin + len(body.points)
        self._state.ranges = wp.array(ranges, dtype=wp.vec2i, device=self.device)
        self._found: dict[str, list[Body | None]] = {}
        self._mobile = {body.name for design in self.designs for body in design.bodies}
        self._terrain = {body.name for design in self.designs for body in design.statics}
        self._action_mask = torch.zeros((self.num_designs, self.num_actions), dtype=torch.bool, device=self.device)
        for d, design in enumerate(self.designs):
            self._action_mask[d, : sum(body.source.num_actuators for body in design.bodies)] = True

    @property
    def action_mask(self) -> torch.Tensor:
        """bool [num_designs, num_actions]: which actions a design has."""
        return self._action_mask.clone()

    @property
    def action_columns(self) -> list[dict[str, slice]]:
        """For each design where the actions of its robots lie, ``{name: slice}``."""
        return [
            {body.name: slice(body.first_action, body.first_action + body.source.num_actuators) for body in d.robots}
            for d in self.designs
        ]

    def _index(self, name: str) -> int:
        if name not in self.object_names:
            hint = did_you_mean(name, self.object_names)
            raise SimulationError(f"No object named {name!r}; there are {listing(self.object_names)}.{hint}")
        return self.object_names.index(name)

    def _bodies(self, name: str) -> list[Body | None]:
        if name not in self._found:
            self._index(name)
            self._found[name] = [design.body(name) for design in self.designs]
        return self._found[name]

    def num_points(self, name: str) -> int:
        """Points of an object, the most over the designs."""
        return max(len(body.points) for body in self._bodies(name) if body)

    def point_mask(self, name: str) -> torch.Tensor:
        """bool [num_designs, points]: which points a design's object has."""
        counts = [len(body.points) if body else 0 for body in self._bodies(name)]
        return torch.arange(max(counts)) < torch.tensor(counts)[:, None]

    def object_grid(self, name: str, design: int = 0) -> np.ndarray:
        """int8 [rows, columns], row 0 on top: the cells of an object."""
        return self._body(name, design).source.grid.copy()

    def voxel_corners(self, name: str, design: int = 0) -> np.ndarray:
        """int32 [voxels, 4]: points at the top left, top right, bottom right and bottom left of every voxel."""
        return np.array(list(self._body(name, design).corners.values()), dtype=np.int32)

    def _body(self, name: str, design: int) -> Body:
        body = self._bodies(name)[design]
        if body is None:
            raise SimulationError(f"Design {design} has no object named {name!r}.")
        return body

    # ----------------------------------------------------------------- sensing

    def object_positions(self, name: str) -> torch.Tensor:
        """[num_envs, points, 2]: positions in simulator units, padded with 0."""
        return self._points(name, 0)

    def object_velocities(self, name: str) -> torch.Tensor:
        """[num_envs, points, 2]: velocities of the integrator, padded with 0."""
        return self._points(name, 1)

    def relative_positions(self, name: str) -> torch.Tensor:
        """[num_envs, 2, points]: x row and y row minus the centre of mass, padded with 0."""
        return self._points(name, 2).transpose(1, 2)

    def _sense(self, key: tuple, kernel: str, dim, shapes: list[tuple], dtype: torch.dtype, *inputs):
        """Run a sensing kernel into buffers of its own; a recorded launch costs a fraction of a new one."""
        if key not in self._sensors:
            buffers = [torch.zeros(shape, dtype=dtype, device=self.device) for shape in shapes]
            kind = wp.vec2d if kernel in ("centres", "extents") else None
            arrays = [wp.from_torch(buffer, dtype=kind) for buffer in buffers]
            self._sensors[key] = sensing.record(self._state, kernel, dim, *inputs, *arrays), buffers
        command, buffers = self._sensors[key]
        command.launch()
        return buffers

    def _points(self, name: str, what: int) -> torch.Tensor:
        shape = (self.num_envs, self.num_points(name), 2)
        if name in self._mobile:
            inputs = [self._index(name), what]
            found = self._sense(("points", *inputs), "points", self.num_envs, [shape], torch.float64, *inputs)[0]
            out = found.to(self.dtype, copy=True)
        else:
            self._index(name)
            out = torch.zeros(shape, dtype=self.dtype, device=self.device)
        if name in self._terrain and what != 1:
            fixed, is_fixed = self._fixed_points(name, what == 2)
            out = torch.where(is_fixed[self.design_index], fixed[self.design_index], out)
        return out

    def _fixed_points(self, name: str, relative: bool) -> tuple[torch.Tensor, torch.Tensor]:
        """Points of an object that never moves, ``[num_designs, points, 2]``, and bool: of which designs it is one."""
        if (name, relative) not in self._fixed:
            fixed = torch.zeros((self.num_designs, self.num_points(name), 2), dtype=torch.float64)
            is_fixed = torch.zeros((self.num_designs, self.num_points(name), 1), dtype=torch.bool)
            for d, design in enumerate(self.designs):
                for body in (body for body in design.statics if body.name == name):
                    points = torch.tensor(body.points, dtype=torch.float64)
                    fixed[d, : len(points)] = points - points.mean(0) if relative else points
                    is_fixed[d, : len(points)] = True
            self._fixed[name, relative] = fixed.to(self.device, self.dtype), is_fixed.to(self.device)
        return self._fixed[name, relative]

    def com(self, name: str) -> torch.Tensor:
        """float64 [num_envs, 2]: centre of mass of an object that can move (B.1)."""
        return self._centres()[0][:, self._moving(name)].clone()

    def velocity(self, name: str) -> torch.Tensor:
        """float64 [num_envs, 2]: velocity of the centre of mass (B.1)."""
        return self._centres()[1][:, self._moving(name)].clone()

    def _moving(self, name: str) -> int:
        index = self._index(name)
        if name not in self._mobile:
            raise SimulationError(f"The object {name!r} is made of fixed cells only: it never moves.")
        return index

    def _centres(self) -> list[torch.Tensor]:
        shape = (self.num_envs, len(self.object_names), 2)
        if self._centres_are_new:
            return self._sensors["centres",][1]
        self._centres_are_new = True
        return self._sense(("centres",), "centres", shape[:2], [shape, shape], torch.float64)

    def orientation(self, name: str) -> torch.Tensor:
        """float64 [num_envs]: orientation in [0, 2 pi), counter-clockwise since time 0 (B.1)."""
        index = self._moving(name)
        shape = (self.num_envs,)
        return self._sense(("orientations", index), "orientations", shape, [shape], torch.float64, index)[0].clone()

    def extent(self, name: str) -> torch.Tensor:
        """float64 [num_envs, 2]: width and height of the box about all points of an object that can move."""
        index = self._moving(name)
        shape = (self.num_envs, 2)
        return self._sense(("extents", index), "extents", shape[:1], [shape], torch.float64, index)[0].clone()

    def hull_area(self, name: str) -> torch.Tensor:
        """float64 [num_envs]: area of the convex hull of all points of an object that can move (B.6.1)."""
        index = self._moving(name)
        shape = (self.num_envs,)
        return self._sense(("hulls", index), "hulls", shape, [shape], torch.float64, index)[0].clone()

    def floor_scan(self, name: str, reach: int, objects: Sequence[str] | None = None) -> torch.Tensor:
        """float64 [num_envs, 2 reach + 1]: depth of the terrain below an object's centre of mass.

        Window i, from -reach to reach voxels beside it and one voxel wide, holds the distance down to the highest
        point of the listed objects (None: all that never move) below the centre; 5 voxels (0.5) where there is none.
        """
        return self._scan(name, reach, objects, -1)

    def ceiling_scan(self, name: str, reach: int, objects: Sequence[str] | None = None) -> torch.Tensor:
        """float64 [num_envs, 2 reach + 1]: the same upward."""
        return self._scan(name, reach, objects, 1)

    def _scan(self, name: str, reach: int, objects: Sequence[str] | None, up: int) -> torch.Tensor:
        listed = tuple(objects) if objects is not None else None
        if listed not in self._scans:
            self._scans[listed] = _scan_tables(self, listed)
        shape = (self.num_envs, 2 * reach + 1)
        inputs = [self._moving(name), reach, float(SIGHT), up]
        tables = self._scans[listed]
        found = self._sense(
            ("scans", *inputs, listed), "scans", self.num_envs, [shape], torch.float64, *inputs, *tables
        )
        return found[0].clone()

    # ---------------------------------------------------------------- state io

    def state(self) -> dict[str, torch.Tensor]:
        """Everything that changes, a row for every environment: what :meth:`set_state` takes back."""
        pack, lane = self._env
        views = {name: self._views[name] for name in STATE_FIELDS}
        return {name: view[pack, :, lane] if view.ndim == 3 else view[pack, lane] for name, view in views.items()}

    def set_state(self, state: dict[str, torch.Tensor]) -> None:
        """Restore what :meth:`state` gave: of the same worlds, or of environments of theirs picked row by row.

        Rows may be longer or shorter than this simulation's by what is only padding: the most points of a world
        depend on which worlds there are.

        Raises:
            SimulationError: fields or shapes that are not this simulation's.
        """
        pack, lane = self._env
        views = {name: self._views[name] for name in STATE_FIELDS}
        least = max(2 * sum(len(body.points) for body in design.bodies) for design in self.designs)
        for name, view in views.items():
            given = state.get(name) if isinstance(state, Mapping) else None
            fits = isinstance(given, torch.Tensor) and given.dtype == view.dtype and given.ndim == view.ndim - 1
            if not fits or len(given) != self.num_envs or (given.ndim == 2 and given.shape[1] < least):
                kind = str(view.dtype).removeprefix("torch.")
                expected = f"{kind} [{self.num_envs}{f', {least} or more' if view.ndim == 3 else ''}]"
                got = f"{given.dtype} {list(given.shape)}" if isinstance(given, torch.Tensor) else f"{given!r:.60}"
                raise SimulationError(
                    f"The state's {name!r} is not that of this simulation of {self.num_envs} environments: expected"
                    f" {expected}, got {got.removeprefix('torch.')}."
                )
        for name, view in views.items():
            if view.ndim == 2:
                view[pack, lane] = state[name]
            else:
                rows = min(view.shape[1], state[name].shape[1])
                view[pack, :rows, lane] = state[name][:, :rows]
        self.invalidate()


STATE_FIELDS = ("pos", "vel", "true_vel", "frozen", "status", "time")


def resolve_device(device: str) -> str:
    """The torch name of a device: 'auto', 'cpu', 'cuda', 'cuda:<index>'.

    Raises:
        DeviceError: no such device here.
    """
    start_warp()
    name = str(device)[:80]
    if name == "auto":
        return "cuda:0" if torch.cuda.is_available() and wp.is_cuda_available() else "cpu"
    if name == "cpu":
        return name
    kind, _, number = name.partition(":")
    if kind != "cuda" or not re.fullmatch("[0-9]{0,4}", number):
        raise DeviceError(f"Unknown device {name!r}; valid are 'auto', 'cpu', 'cuda' and 'cuda:<index>'.")
    found = torch.cuda.device_count() if torch.cuda.is_available() and wp.is_cuda_available() else 0
    if int(number or 0) >= found:
        have = f"this machine has {found} CUDA device(s)" if found else "no CUDA device was found"
        raise DeviceError(f"Device {device!r} is not available: {have}. Use device=cpu or device=auto.")
    return f"cuda:{int(number or 0)}"


def _torch(array: wp.array) -> torch.Tensor:
    return wp.to_torch(array).long()


def _check_names(loose: Sequence[str]) -> None:
    if not isinstance(loose, Sequence) or isinstance(loose, str) or not all(isinstance(name, str) for name in loose):
        raise SimulationError(f"loose must be a list of names of objects, got {loose!r:.80}.")


def _check_range(action_range: tuple[float, float]) -> tuple[float, float]:
    try:
        low, high = (float(bound) for bound in action_range)
    except (TypeError, ValueError, OverflowError):
        low, high = 1.0, 0.0
    if not low <= high:  # NaN, too
        raise SimulationError(f"action_range must be two numbers low <= high, got {action_range!r:.80}.")
    return low, high


def _loose_points(sim: Simulation, names: Sequence[str]) -> tuple[torch.Tensor, ...]:
    """Of all points of the loose objects, for every design: index, cell and height of the object, column and row."""
    tables: list[list[list[int]]] = []
    for design in sim.designs:
        rows = []
        for name in names:
            body = design.body(name)
            if body is None:
                raise SimulationError(f"All worlds need the loose object {name!r}; one has no object of that name.")
            source = body.source
            for p, (x, y) in enumerate(body.points):
                column, row = round(x / VOXEL) - source.x, source.y + source.height - round(y / VOXEL)
                rows.append([body.first_point + p, source.x, source.y, source.height, column, row])
        tables.append(rows)
    if len({len(rows) for rows in tables}) != 1:
        raise SimulationError(f"The loose objects {listing(names)} must have the same cells in all worlds.")
    table = torch.tensor(tables, dtype=torch.long, device=sim.device).reshape(len(tables), -1 if tables[0] else 0, 6)
    return table[..., 0], table[..., 1:3], table[..., 3], table[..., 4:6]


def _scan_tables(sim: Simulation, objects: tuple[str, ...] | None) -> tuple[wp.array, wp.array, wp.array]:
    """Static points in voxels by lattice column, where each column starts, and points of listed bodies."""
    for name in objects or ():
        sim._index(name)
    still, moving = [], []
    for design in sim.designs:
        listed = [b for b in design.statics if objects is None or b.name in objects]
        points = [(x / VOXEL, y / VOXEL) for body in listed for x, y in body.points]
        still.append(sorted(points, key=lambda p: round(p[0])))
        bodies = [b for b in design.bodies if objects is not None and b.name in objects]
        moving.append([b.first_point + p for b in bodies for p in range(len(b.points))])
    columns = max(design.world.width for design in sim.designs) + 1
    start = np.zeros((sim.num_designs, columns + 1), dtype=np.int32)
    table = np.zeros((sim.num_designs, max(1, *(len(p) for p in still)), 2))
    body_points = np.full((sim.num_designs, max(1, *(len(p) for p in moving))), -1, dtype=np.int32)
    for d, points in enumerate(still):
        start[d] = np.searchsorted([round(x) for x, _ in points], np.arange(columns + 1))
        table[d, : len(points)] = np.reshape(points, (-1, 2))
        body_points[d, : len(moving[d])] = moving[d]
    return (
        wp.array(start, dtype=int, device=sim.device),
        wp.array(table, dtype=wp.vec2d, device=sim.device),
        wp.array(body_points, dtype=int, device=sim.device),
    )
