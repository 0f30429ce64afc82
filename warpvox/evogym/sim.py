"""The simulation under the names of EvoGym's module ``evogym.sim``. Lengths are in voxels here."""

from __future__ import annotations

import numpy as np

from warpvox.errors import listing
from warpvox.evogym.errors import ArgumentError, ArgumentTypeError
from warpvox.evogym.simulator_cpp import Sim
from warpvox.evogym.utils import *  # noqa: F403  # as in the release, scripts may take them from here
from warpvox.evogym.world import EvoWorld
from warpvox.types import VOXEL

__all__ = ["EvoSim"]


class EvoSim(Sim):
    """One world, stepped in float64 with the physics of the release.

    All control steps since the reset are recorded: methods with a ``time`` return any of them, 0 to :meth:`get_time`.
    Objects come robots first, then the others, each by name; their points in the order of their cells, row by row from
    the top.

    Args:
        world: what there is.

    Raises:
        WorldError: an object is not valid. SimulationError: the world is empty.
    """

    VOXEL_SIZE = VOXEL

    def __init__(self, world: EvoWorld) -> None:
        super().__init__()
        self.init(world.grid_size.x, world.grid_size.y)
        for obj in world.objects.values():
            self._plan.add_object(obj.to_core())
        self._object_names = sorted(self._plan.objects)
        self._robot_names = [name for name in self._object_names if self._plan.objects[name].is_robot]

    def reset(self) -> None:
        """Go back to time 0. Targets of actuators stay as they are."""
        self.revert(0)

    def get_actuator_indices(self, robot_name: str) -> np.ndarray:
        """int32 ``[actuators]``: flat indices of a robot's actuators, row by row from the top.

        Raises:
            ArgumentError (a ValueError): there is no such robot.
        """
        self._check_valid_robot_name(robot_name)
        return self._engine.actuators(robot_name)

    def get_dim_action_space(self, robot_name: str) -> int:
        """Number of a robot's actuators.

        Raises:
            ArgumentError: there is no such robot.
        """
        return len(self.get_actuator_indices(robot_name))

    def set_action(self, robot_name: str, action: np.ndarray) -> None:
        """Set targets of a robot's actuators from the next step on.

        Args:
            robot_name: of the robot.
            action: ``[actuators]``, lengths of their sides in units of their rest length. Not clipped.

        Raises:
            ArgumentError: no such robot, or another number of values.
        """
        self._check_valid_robot_name(robot_name)
        goals = self._engine.goals[robot_name]
        values = np.asarray(action).reshape(-1)
        if values.shape != goals.shape:
            raise ArgumentError(f"'{robot_name}' has {len(goals)} actuators, but the action has {len(values)} values.")
        goals[:] = values

    def pos_at_time(self, time: int) -> np.ndarray:
        """``[2, points]``: positions of all points, object by object.

        Raises:
            ArgumentError: that time has not been. ArgumentTypeError: it is not an integer.
        """
        self._check_valid_time(time)
        return self._engine.all_positions(time).T / VOXEL

    def vel_at_time(self, time: int) -> np.ndarray:
        """``[2, points]``: velocities of all points; errors as :meth:`pos_at_time`.

        Voxels per inner time, of which a control step takes 30 x 1e-4.
        """
        self._check_valid_time(time)
        return self._engine.all_velocities(time).T / VOXEL

    def object_pos_at_time(self, time: int, object_name: str) -> np.ndarray:
        """``[2, points]``: positions of an object's points.

        Raises:
            ArgumentError: no such object, or that time has not been. ArgumentTypeError: it is not an integer.
        """
        self._check_valid_time(time)
        self._check_valid_object_name(object_name)
        return self._engine.positions(time, object_name).T / VOXEL

    def object_vel_at_time(self, time: int, object_name: str) -> np.ndarray:
        """``[2, points]``: velocities of an object's points; errors as :meth:`object_pos_at_time`."""
        self._check_valid_time(time)
        self._check_valid_object_name(object_name)
        return self._engine.velocities(time, object_name).T / VOXEL

    def object_orientation_at_time(self, time: int, object_name: str) -> float:
        """How far an object has turned since time 0, counter-clockwise, radians in [0, 2 pi].

        Errors as :meth:`object_pos_at_time`.
        """
        self._check_valid_time(time)
        self._check_valid_object_name(object_name)
        return self._engine.orientation(time, object_name)

    def _check_valid_time(self, time: int) -> None:
        if not isinstance(time, int):
            raise ArgumentTypeError(f"time must be an integer, got {time!r} of type {type(time).__name__}.")
        if not 0 <= time <= self._engine.time:
            raise ArgumentError(f"time must lie between 0 and {self._engine.time}, got {time}.")

    def _check_valid_robot_name(self, robot_name: str) -> None:
        if robot_name not in self._robot_names:
            raise ArgumentError(f"{robot_name} is not a valid robot name; robots are {listing(self._robot_names)}.")

    def _check_valid_object_name(self, object_name: str) -> None:
        if object_name not in self._object_names:
            raise ArgumentError(f"{object_name} is not a valid object name; objects are {listing(self._object_names)}.")
