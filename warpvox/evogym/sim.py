"""The simulation under the names of EvoGym's module ``evogym.sim``. Lengths are in voxels here."""

from __future__ import annotations

import numpy as np

from warpvox.evogym.errors import ArgumentError
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

    def reset(self) -> None:
        """Go back to time 0. Targets of actuators stay as they are."""
        self.revert(0)

    def get_actuator_indices(self, robot_name: str) -> np.ndarray:
        """int32 ``[actuators]``: flat indices of a robot's actuators, row by row from the top.

        Raises:
            ArgumentError (a ValueError): there is no such robot.
        """
        self._check_robot(robot_name)
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
        self._check_robot(robot_name)
        goals = self._engine.goals[robot_name]
        values = np.asarray(action).reshape(-1)
        if values.shape != goals.shape:
            raise ArgumentError(f"'{robot_name}' has {len(goals)} actuators, but the action has {len(values)} values.")
        goals[:] = values

    def pos_at_time(self, time: int) -> np.ndarray:
        """``[2, points]``: positions of all points, object by object.

        Raises:
            ArgumentError: the time is not recorded. ArgumentTypeError: it is not an integer.
        """
        return super().pos_at_time(time) / VOXEL

    def vel_at_time(self, time: int) -> np.ndarray:
        """``[2, points]``: velocities of all points; errors as :meth:`pos_at_time`.

        Voxels per inner time, of which a control step takes 30 x 1e-4.
        """
        return super().vel_at_time(time) / VOXEL

    def object_pos_at_time(self, time: int, object_name: str) -> np.ndarray:
        """``[2, points]``: positions of an object's points.

        Raises:
            ArgumentError: no such object, or the time is not recorded. ArgumentTypeError: it is not an integer.
        """
        return super().object_pos_at_time(time, object_name) / VOXEL

    def object_vel_at_time(self, time: int, object_name: str) -> np.ndarray:
        """``[2, points]``: velocities of an object's points; errors as :meth:`object_pos_at_time`."""
        return super().object_vel_at_time(time, object_name) / VOXEL
