"""Manipulation tasks (carry, push, throw, catch, topple), under the names of ``evogym.envs.manipulate``."""

import random
from typing import Any

import gymnasium
import numpy as np

from warpvox.envs.spec import TaskSpec
from warpvox.evogym.envs.base import BenchmarkBase
from warpvox.evogym.envs.task import TaskEnv, task_env
from warpvox.evogym.sim import EvoSim
from warpvox.evogym.world import EvoWorld
from warpvox.types import VOXEL

__all__ = [
    "CarrySmallRect",
    "CarrySmallRectToTable",
    "CatchSmallRect",
    "LiftSmallRect",
    "PackageBase",
    "PushSmallRect",
    "PushSmallRectOnOppositeSide",
    "SlideBeam",
    "ThrowSmallRect",
    "ToppleBeam",
]


class PackageBase(BenchmarkBase):
    """Base class of tasks with an object ``package``, penalised if it falls below ``thresh_height``."""

    thresh_height = 0.0

    def __init__(self, world: EvoWorld, render_mode: str | None = None, render_options: dict | None = None) -> None:
        super().__init__(world=world, render_mode=render_mode, render_options=render_options)
        self.default_viewer.track_objects("robot", "package")

    def get_obs(
        self,
        robot_pos_final: np.ndarray,
        robot_vel_final: np.ndarray,
        package_pos_final: np.ndarray,
        package_vel_final: np.ndarray,
    ) -> np.ndarray:
        """Return the velocity of the robot, the vector from robot to package, and the package's velocity: ``[6]``."""
        robot = np.mean(robot_pos_final, axis=1)
        package = np.mean(package_pos_final, axis=1)
        robot_speed = np.mean(robot_vel_final, axis=1)
        package_speed = np.mean(package_vel_final, axis=1)
        return np.concatenate([robot_speed, package - robot, package_speed])

    def get_reward(
        self,
        package_pos_init: np.ndarray,
        package_pos_final: np.ndarray,
        robot_pos_init: np.ndarray,
        robot_pos_final: np.ndarray,
    ) -> float:
        """Return the reward for moving robot and package to the right and together, minus a drop penalty.

        Positions are ``[2, n]``.
        """
        package_0 = np.mean(package_pos_init, axis=1)
        package_1 = np.mean(package_pos_final, axis=1)
        robot_0 = np.mean(robot_pos_init, axis=1)
        robot_1 = np.mean(robot_pos_final, axis=1)
        reward = 0.75 * (package_1[0] - package_0[0]) + 0.5 * (robot_1[0] - robot_0[0])
        reward += abs(robot_0[0] - package_0[0]) - abs(robot_1[0] - package_1[0])
        return reward + (10 * (package_1[1] - package_0[1]) if package_1[1] < self.thresh_height else 0.0)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Begin an episode; return the observation (:meth:`get_obs` and the robot's points) and a dictionary."""
        super().reset(seed=seed, options=options)
        now = self.get_time()
        reads = self.object_pos_at_time, self.object_vel_at_time
        parts = [read(now, name) for name in ("robot", "package") for read in reads]
        return np.concatenate([self.get_obs(*parts), self.get_relative_pos_obs("robot")]), {}


class CatchSmallRect(TaskEnv, PackageBase):
    """Catcher-v0: package and pegs start every episode at a random position.

    The place is drawn when the environment is made and at every reset, as released from Python's global generator
    ``random``; ``reset(seed=...)`` gives the environment a generator of its own.

    Attributes:
        offsetx, offsety: the present place, in cells from that in the world.
    """

    task = "Catcher-v0"
    thresh_height = 5 * VOXEL
    _random: Any = random

    def _make_world(self, spec: TaskSpec, body: np.ndarray, connections: np.ndarray | None) -> EvoWorld:
        """Build the world with package and pegs shifted by a random offset."""
        world = super()._make_world(spec, body, connections)
        self.offsetx, self.offsety = self._random.randint(-6, 4), self._random.randint(0, 5)
        places = {obj.name: (obj.x + self.offsetx, obj.y + self.offsety) for obj in spec.objects}
        for name in spec.randomized:
            world.move_object(name, *places[name])
        self._made_of = (spec, body, connections)
        return world

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Begin an episode with the package at a random position; return observation and empty dictionary."""
        gymnasium.Env.reset(self, seed=seed)
        if seed is not None:
            self._random = random.Random(seed)
        self.world = self._make_world(*self._made_of)
        self._sim = EvoSim(self.world)
        self.default_viewer.look_at(self._sim)
        return self._observe(self._state()), {}


CarrySmallRect = task_env("CarrySmallRect", "Carrier-v0", PackageBase, thresh_height=3 * VOXEL)
CarrySmallRectToTable = task_env("CarrySmallRectToTable", "Carrier-v1", PackageBase, thresh_height=6 * VOXEL)
PushSmallRect = task_env("PushSmallRect", "Pusher-v0", PackageBase)
PushSmallRectOnOppositeSide = task_env("PushSmallRectOnOppositeSide", "Pusher-v1", PackageBase)
ThrowSmallRect = task_env("ThrowSmallRect", "Thrower-v0", PackageBase)
ToppleBeam = task_env("ToppleBeam", "BeamToppler-v0", PackageBase)
SlideBeam = task_env("SlideBeam", "BeamSlider-v0", PackageBase)
LiftSmallRect = task_env("LiftSmallRect", "Lifter-v0", PackageBase)
