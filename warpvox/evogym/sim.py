"""The simulation under the names of EvoGym's module ``evogym.sim``, with lengths in voxels."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

from warpvox.evogym.errors import ArgumentError, ArgumentTypeError
from warpvox.evogym.simulator_cpp import Sim
from warpvox.evogym.utils import *  # noqa: F403  # as in the release, scripts may take them from here
from warpvox.evogym.world import EvoWorld
from warpvox.types import VOXEL

__all__ = ["EvoSim"]


def _in_voxels(method: Callable[..., np.ndarray]) -> Callable[..., np.ndarray]:
    """Decorate a method so that its result is in voxels instead of simulator units (0.1 a voxel)."""

    @functools.wraps(method)
    def scaled(*args: object, **options: object) -> np.ndarray:
        return method(*args, **options) / VOXEL

    return scaled


class EvoSim(Sim):
    """One world, stepped in float64 with the physics of the release.

    All control steps since the reset are recorded: methods with a ``time`` return any of them, 0 to :meth:`get_time`.
    A step takes 32 bytes for each point of the world. ``EvoSim.history = 1`` keeps only the present one and time 0.
    Objects come robots first, then the others, each by name; their points in the order of their cells, row by row from
    the top.

    Raises:
        ArgumentTypeError: no world. WorldError: an object is not valid. SimulationError: the world is empty.
    """

    VOXEL_SIZE = VOXEL

    def __init__(self, world: EvoWorld) -> None:
        if not isinstance(world, EvoWorld):
            raise ArgumentTypeError(f"EvoSim takes an EvoWorld, got {world!r:.80}; EvoWorld.from_json(FILE) reads one.")
        super().__init__()
        self.init(world.grid_size.x, world.grid_size.y)
        for obj in world.objects.values():
            self._plan.add_object(obj.to_core())

    def reset(self) -> None:
        """Reset to time 0; targets of actuators are kept."""
        self.revert(0)

    def get_actuator_indices(self, robot_name: str) -> np.ndarray:
        """Return the flat indices of a robot's actuators, row by row from the top: int32 ``[actuators]``."""
        return self._engine.actuators(robot_name)

    def get_dim_action_space(self, robot_name: str) -> int:
        """Return the number of a robot's actuators; ArgumentError (a ValueError): no such robot."""
        return len(self.get_actuator_indices(robot_name))

    def set_action(self, robot_name: str, action: np.ndarray) -> None:
        """Set the target lengths of a robot's actuators, relative to rest length, from the next step on.

        ``action``: ``[actuators]``, not clipped. ArgumentError: no such robot, or another number of values.
        """
        goals = self._engine.goals_of(robot_name)
        values = np.asarray(action).reshape(-1)
        if values.shape != goals.shape:
            raise ArgumentError(f"'{robot_name}' has {len(goals)} actuators, but the action has {len(values)} values.")
        goals[:] = values

    pos_at_time = _in_voxels(Sim.pos_at_time)
    vel_at_time = _in_voxels(Sim.vel_at_time)
    object_pos_at_time = _in_voxels(Sim.object_pos_at_time)
    object_vel_at_time = _in_voxels(Sim.object_vel_at_time)
