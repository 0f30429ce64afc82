"""One simulated environment with numpy views of its points, and a record of all control steps.

As in the release, positions and velocities of any control step since the reset can be read.
"""

from functools import cached_property

import numpy as np

from warpvox.batch.options import SimOptions
from warpvox.checks import check_integer
from warpvox.envs.adapters.single import Sensors
from warpvox.errors import did_you_mean, listing
from warpvox.evogym.errors import ArgumentError, ArgumentTypeError
from warpvox.kernels.state import STOPPED
from warpvox.simulation import Simulation
from warpvox.types import Cell
from warpvox.world import World

__all__ = ["Engine"]


class Engine:
    """One world, stepped in float64 with the physics of EvoGym's release, and the record of its control steps.

    Points come object by object, robots first, then the others, each by name; an object's points in the order of its
    cells, row by row from the top. Positions are in simulator units (0.1 a voxel).

    Attributes:
        time: complete control steps.
        goals: by the name of each robot float64 ``[actuators]``, target lengths for the next step. May be written into.
        changes: counter of changes of the points.

    Raises:
        SimulationError: the world is empty.
    """

    def __init__(self, world: World) -> None:
        """Build the simulation and record the state at time 0."""
        self.world = world
        # Objects that may be moved although none of their cells can: a simulation needs something that can move.
        self._loose = tuple(world.objects) if all(obj.is_static for obj in world.objects.values()) else ()
        self._build()
        self.time = self.changes = 0
        start = np.array([point for name in self._spans for point in self._bodies[name].points])
        self._past = {0: np.stack([start, np.zeros_like(start)])}  # positions and velocities of all points
        self._orientations: dict[str, float] = {}  # of objects that cannot move
        self._record()

    def _build(self) -> None:
        """Create the simulation and numpy views of its arrays."""
        options = SimOptions("cpu", "float64", lanes=1, threads=1)
        # EvoGym takes actions beyond its own range, too.
        anything = (-np.inf, np.inf)
        sim = Simulation([self.world], options, loose=self._loose, action_range=anything)
        self._sim = sim
        self.sensors = Sensors(sim)
        moving = sim.designs[0].bodies
        statics = sim.designs[0].statics
        self._views = {name: sim.array(name).numpy().reshape(-1, 2) for name in ("pos", "vel", "true_vel", "rest_pos")}
        self._status = sim.array("status").numpy().reshape(-1)
        self._actions = sim.action_buffer.numpy()[0]  # of all robots
        self._actions[:] = 1.0  # until an action is set, actuators keep their length
        self.goals = {}
        for body in sim.designs[0].robots:
            last = body.first_action + body.source.num_actuators
            self.goals[body.name] = self._actions[body.first_action : last]

        # A record has the points of what moves first, as the simulation has them.
        recorded = sorted(moving, key=lambda body: body.first_point) + statics
        self._moving = sum(len(body.points) for body in moving)
        self._spans = {}
        begin = 0
        for body in recorded:
            end = begin + len(body.points)
            self._spans[body.name] = slice(begin, end)
            begin = end

        # All objects: robots first, each by name
        ordered = sorted(recorded, key=lambda body: (not body.source.is_robot, body.name))
        self._bodies = {body.name: body for body in ordered}
        self._rows = np.concatenate([np.arange(begin)[self._spans[name]] for name in self._bodies])

    def step(self, history: int | None = None) -> bool:
        """Advance the world by a control step; return True if self-folding or divergence undid it.

        Args:
            history: how many of the last times are kept, besides time 0; None: all.

        Raises:
            ArgumentError: ``history`` is no integer from 1 on.
        """
        if history is not None:
            check_integer("history", history, 1, error=ArgumentError)
        self._sim.advance()
        self._forget_sensed()
        if self._status[0] & STOPPED:
            return True
        self.time += 1
        self._record()
        if history is not None:
            oldest = self.time - history
            while oldest > 0 and self._past.pop(oldest, None) is not None:
                oldest -= 1
        return False

    def _record(self) -> None:
        now = self._past[self.time] = self._past[0].copy()  # with what cannot move
        now[0, : self._moving] = self._views["pos"]
        now[1, : self._moving] = self._views["vel"]

    def revert(self, time: int) -> None:
        """Restore the state at a recorded time and drop later records."""
        self._set(self._recorded_state(time))
        self.time = time
        self._past = {then: kept for then, kept in self._past.items() if then <= time}

    def _set(self, record: np.ndarray) -> None:
        self._views["pos"][:] = record[0, : self._moving]
        self._views["vel"][:] = record[1, : self._moving]
        self._views["true_vel"][:] = self._views["vel"]
        self._sim.invalidate()
        self._forget_sensed()

    def _forget_sensed(self) -> None:
        """Invalidate cached centres of mass after points have moved."""
        self.changes += 1
        self.sensors.moved = True

    def translate(self, name: str, dx: float, dy: float) -> None:
        """Move all points of an object, in simulator units; overlaps are not checked."""
        self._check(name)
        if name not in self._loose and (self._bodies[name].source.grid == Cell.FIXED).any():
            # Rebuilt, the simulation can move an object of fixed cells.
            actions = self._actions.copy()
            before = self._rows
            self._loose = (*self._loose, name)
            self._build()
            self._actions[:] = actions
            self._past = {time: kept[:, before[np.argsort(self._rows)]] for time, kept in self._past.items()}
            self._set(self._past[self.time])
        self._views["pos"][self._spans[name]] += (dx, dy)
        self._sim.invalidate()
        self._forget_sensed()
        self._record()
        self._views["rest_pos"][:] = self._past[0][0, : self._moving]  # what turns are measured from

    def _recorded_state(self, time: int) -> np.ndarray:
        """Return the recorded state at a time; ArgumentError if there is none."""
        if not isinstance(time, int | np.integer):
            raise ArgumentTypeError(f"time must be an integer, got {time!r} of type {type(time).__name__}.")
        if time not in self._past:
            if 0 < time < self.time:
                raise ArgumentError(f"EvoSim.history keeps the times {listing(self._past)} alone, got {time}.")
            raise ArgumentError(f"time must lie between 0 and {self.time}, got {time}.")
        return self._past[time]

    def _check(self, name: object, kind: str = "object") -> None:
        """Raise ArgumentError unless ``name`` is an object (``kind="robot"``: a robot)."""
        names = self.goals if kind == "robot" else self._spans
        if not isinstance(name, str) or name not in names:
            why = " It has no actuator (cells 3, 4)." if str(name) in self._spans else did_you_mean(name, names)
            raise ArgumentError(f"{name!r:.80} is not a valid {kind} name; {kind}s are {listing(sorted(names))}.{why}")

    def _point_slice(self, name: str | None) -> slice | np.ndarray:
        """Return the slice of an object's points in a recorded state (None: all points)."""
        if name is not None:
            self._check(name)
        return self._rows if name is None else self._spans[name]

    def positions(self, time: int, name: str | None = None) -> np.ndarray:
        """Return positions of an object's points (None: of all objects), ``[points, 2]``, read-only."""
        return self._recorded_state(time)[0, self._point_slice(name)]

    def velocities(self, time: int, name: str | None = None) -> np.ndarray:
        """Return velocities of an object's points (None: of all objects), ``[points, 2]``, read-only."""
        return self._recorded_state(time)[1, self._point_slice(name)]

    def orientation(self, time: int, name: str) -> float:
        """Return the rotation of an object since time 0, counter-clockwise in [0, 2 pi]."""
        self._check(name)
        then, _ = self._recorded_state(time)
        if self._spans[name].start >= self._moving:
            # Alone in its world an object can be moved; one that has not moved has the same orientation at any time.
            if name not in self._orientations:
                alone = World()
                alone.add_object(self._bodies[name].source)
                self._orientations[name] = Engine(alone).orientation(0, name)
            return self._orientations[name]
        now = self._views["pos"].copy()
        self._views["pos"][:] = then[: self._moving]
        angle = self.sensors.orientation(name).item()
        self._views["pos"][:] = now
        return angle

    def goals_of(self, robot: str) -> np.ndarray:
        """Return the actuators' goal lengths of a robot, see :attr:`goals`; ArgumentError: no such robot."""
        self._check(robot, "robot")
        return self.goals[robot]

    def actuators(self, robot: str) -> np.ndarray:
        """Return the flat indices of a robot's actuators, row by row from the top: int32 ``[actuators]``."""
        self.goals_of(robot)
        grid = self._bodies[robot].source.grid
        return np.flatnonzero(np.isin(grid, (Cell.H_ACT, Cell.V_ACT))).astype(np.int32)

    @cached_property
    def cells(self) -> np.ndarray:
        """Types of all cells, object by object: int8 ``[voxels]``."""
        return np.array([body.kind(cell) for body in self._bodies.values() for cell in body.cells], np.int8)

    @cached_property
    def corners(self) -> np.ndarray:
        """Point indices of each cell: top left, top right, bottom right and bottom left, int ``[voxels, 4]``."""
        bodies = list(self._bodies.values())
        firsts = np.cumsum([0, *(len(body.points) for body in bodies[:-1])])
        corners = [np.array(list(body.corners.values())) for body in bodies]
        return np.concatenate([each + first for each, first in zip(corners, firsts, strict=True)])

    @cached_property
    def outlines(self) -> np.ndarray:
        """Point indices of the two ends of each outer side, int ``[sides, 2]``."""
        sides = np.stack([self.corners, np.roll(self.corners, -1, axis=1)], axis=-1).reshape(-1, 2)
        _, first, counts = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
        return sides[first[counts == 1]]
