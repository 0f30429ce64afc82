"""One environment of the simulator with numpy views of its points, and a record of all control steps.

As in the release, positions and velocities of any control step since the reset can be read.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from warpvox.batch.options import SimOptions
from warpvox.envs.adapters.single import Sensors
from warpvox.errors import listing
from warpvox.evogym.errors import ArgumentError, ArgumentTypeError
from warpvox.kernels.state import DIVERGED, UNSTABLE
from warpvox.simulation import Simulation
from warpvox.types import Cell
from warpvox.world import World

__all__ = ["Engine"]

_STOPPED = int(UNSTABLE) | int(DIVERGED)
_ANY_NUMBER = (-np.inf, np.inf)


class Engine:
    """A world that is stepped in float64 with the release's physics.

    Points come object by object, robots first, then the others, each by name; an object's points in the order of its
    cells, row by row from the top. Positions are in simulator units (0.1 a voxel).

    Args:
        world: the objects.
        loose: names of objects that may be moved although none of their cells can move.

    Attributes:
        names: objects in their order.
        robots: names of those with actuators.
        time: complete control steps.
        goals: for every robot float64 ``[actuators]``, target lengths for the next step. May be written into.
        changes: counter of changes of the points.

    Raises:
        SimulationError: the world is empty.
    """

    def __init__(self, world: World, loose: tuple[str, ...] = ()) -> None:
        if all(obj.is_static for obj in world.objects.values()):
            loose = tuple(world.objects)  # a simulation needs something that can move
        self.world, self._loose = world, loose
        self._build()
        self.time = self.changes = 0
        self._past: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._record()

    def _build(self) -> None:
        sim = Simulation(
            [self.world], SimOptions("cpu", "float64", lanes=1, threads=1), loose=self._loose, action_range=_ANY_NUMBER
        )
        design = sim.designs[0]
        self._views = {name: sim.array(name).numpy().reshape(-1, 2) for name in ("pos", "vel", "true_vel")}
        self._status = sim.array("status").numpy().reshape(-1)
        self._actions = sim.action_buffer.numpy()[0]  # of all robots
        self._actions[:] = 1.0  # until an action is set, actuators keep their length
        self._bodies = {body.name: body for body in design.bodies + design.statics}
        self.names = sorted(self._bodies, key=lambda name: (not self._bodies[name].source.is_robot, name))
        self.robots = [body.name for body in design.robots]
        self._spans = {b.name: slice(b.first_point, b.first_point + len(b.points)) for b in design.bodies}
        counts = {body.name: body.source.num_actuators for body in design.robots}
        self.goals = {b.name: self._actions[b.first_action :][: counts[b.name]] for b in design.robots}
        self._static = {body.name: np.array(body.points) for body in design.statics}
        self._sim, self.sensors = sim, Sensors(sim)
        self._orientations: dict[str, float] = {}  # of objects that cannot move

    # ------------------------------------------------------------------------------------------- stepping

    def step(self) -> bool:
        """One control step; True if self-folding (or numbers that are not finite) stopped and undid it."""
        self._sim.advance()
        self._moved()
        if self._status[0] & _STOPPED:
            return True
        self.time += 1
        self._record()
        return False

    def _record(self) -> None:
        self._past[self.time] = (self._views["pos"].copy(), self._views["vel"].copy())

    def revert(self, time: int) -> None:
        """Go back to a recorded time and drop the records after it."""
        pos, vel = self._at(time)
        self._set(pos, vel)
        self.time = time
        self._past = {then: kept for then, kept in self._past.items() if then <= time}

    def _set(self, pos: np.ndarray, vel: np.ndarray) -> None:
        self._views["pos"][:] = pos
        self._views["vel"][:] = self._views["true_vel"][:] = vel
        self._sim.invalidate()
        self._moved()

    def _moved(self) -> None:
        """Points have moved: what was sensed of them no longer holds."""
        self.changes += 1
        self.sensors.moved = True

    def translate(self, name: str, dx: float, dy: float) -> None:
        """Move all points of an object, in simulator units; overlaps are not checked."""
        if name not in self._loose and (self._bodies[name].source.grid == Cell.FIXED).any():
            self._loosen(name)
        self._views["pos"][self._spans[name]] += (dx, dy)
        self._sim.invalidate()
        self._moved()
        self._record()

    def _loosen(self, name: str) -> None:
        """Rebuild the simulation so that an object of fixed cells can be moved; add its points to the record."""
        past, actions = self._past, self._actions.copy()
        parts_at = {time: [self._parts(kept) for kept in past[time]] for time in past}
        static, self._loose = self._static, (*self._loose, name)
        self._build()
        self._actions[:] = actions
        moving = [body.name for body in self._sim.designs[0].bodies]
        if name in static:  # it has not moved so far
            for pos, vel in parts_at.values():
                pos[name], vel[name] = static[name], np.zeros_like(static[name])
        self._past = {
            time: (np.concatenate([pos[each] for each in moving]), np.concatenate([vel[each] for each in moving]))
            for time, (pos, vel) in parts_at.items()
        }
        self._set(*self._past[self.time])

    def _parts(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        return {body.name: rows[self._spans[body.name]] for body in self._sim.designs[0].bodies}

    # -------------------------------------------------------------------------------------------- looking

    def _at(self, time: int) -> tuple[np.ndarray, np.ndarray]:
        if not isinstance(time, int | np.integer):
            raise ArgumentTypeError(f"time must be an integer, got {time!r} of type {type(time).__name__}.")
        if time not in self._past:
            raise ArgumentError(f"time must lie between 0 and {self.time}, got {time}.")
        return self._past[time]

    def check(self, name: str) -> None:
        """Raise ArgumentError unless there is an object of that name."""
        if name not in self._bodies:
            raise ArgumentError(f"{name} is not a valid object name; objects are {listing(sorted(self.names))}.")

    def positions(self, time: int, name: str) -> np.ndarray:
        """``[points, 2]``, not to be written into."""
        pos, _ = self._at(time)
        return self._static[name] if name in self._static else pos[self._spans[name]]

    def velocities(self, time: int, name: str) -> np.ndarray:
        """``[points, 2]``, not to be written into."""
        _, vel = self._at(time)
        return np.zeros_like(self._static[name]) if name in self._static else vel[self._spans[name]]

    def all_positions(self, time: int) -> np.ndarray:
        """``[points, 2]`` of all objects."""
        return np.concatenate([self.positions(time, name) for name in self.names])

    def all_velocities(self, time: int) -> np.ndarray:
        """``[points, 2]`` of all objects."""
        return np.concatenate([self.velocities(time, name) for name in self.names])

    def orientation(self, time: int, name: str) -> float:
        """How far an object has turned since time 0, counter-clockwise in [0, 2 pi]."""
        then, _ = self._at(time)
        if name in self._static:
            # Alone in its world an object can be moved; one that has not moved has the same orientation at any time.
            if name not in self._orientations:
                alone = World()
                alone.add_object(self._bodies[name].source)
                self._orientations[name] = Engine(alone).orientation(0, name)
            return self._orientations[name]
        if time == self.time:
            return self.sensors.orientation(name).item()
        now = self._views["pos"].copy()
        self._views["pos"][:] = then
        angle = self.sensors.orientation(name).item()
        self._views["pos"][:] = now
        return angle

    # --------------------------------------------------------------------------------------------- robots

    def actuators(self, name: str) -> np.ndarray:
        """int32 ``[actuators]``: flat indices of a robot's actuators, row by row from the top."""
        grid = self._bodies[name].source.grid
        return np.flatnonzero(np.isin(grid, (Cell.H_ACT, Cell.V_ACT))).astype(np.int32)

    # ------------------------------------------------------------------------------------------- pictures

    @cached_property
    def cells(self) -> np.ndarray:
        """int8 ``[voxels]``: types of all cells, object by object."""
        return np.array([body.kind(cell) for body in self._in_order() for cell in body.cells], np.int8)

    @cached_property
    def corners(self) -> np.ndarray:
        """int ``[voxels, 4]``: all points' indices at the top left, top right, bottom right and bottom left."""
        parts, first = [], 0
        for body in self._in_order():
            parts.append(np.array(list(body.corners.values())) + first)
            first += len(body.points)
        return np.concatenate(parts)

    @cached_property
    def outlines(self) -> np.ndarray:
        """int ``[sides, 2]``: all points' indices at the ends of sides that no other cell shares."""
        sides = np.stack([self.corners, np.roll(self.corners, -1, axis=1)], axis=-1).reshape(-1, 2)
        _, first, counts = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
        return sides[first[counts == 1]]

    def _in_order(self) -> list:
        return [self._bodies[name] for name in self.names]
