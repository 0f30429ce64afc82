"""Uneven terrain, under the names of EvoGym's module ``evogym.envs.traverse``."""

from typing import Any

import numpy as np

from warpvox.evogym.envs.base import BenchmarkBase
from warpvox.evogym.envs.task import task_env

__all__ = [
    "BlockSoup",
    "FloatingPlatform",
    "Gaps",
    "StairsBase",
    "StepsDown",
    "StepsUp",
    "VerticalBarrier",
    "WalkingBumpy",
    "WalkingBumpy2",
]


class StairsBase(BenchmarkBase):
    """Base class of tasks on a terrain ``ground``; subclasses set ``sight_dist``, the width of the view of it."""

    sight_dist: int

    def get_reward(self, robot_pos_init: np.ndarray, robot_pos_final: np.ndarray) -> float:
        """Return the distance that the mean of points ``[2, n]`` moved along x."""
        return np.mean(robot_pos_final[0]) - np.mean(robot_pos_init[0])

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Begin an episode; return observed velocity, orientation, points and floor, and an empty dictionary."""
        super().reset(seed=seed, options=options)
        parts = [self.get_vel_com_obs("robot"), self.get_ort_obs("robot"), self.get_relative_pos_obs("robot")]
        return np.concatenate([*parts, self.get_floor_obs("robot", ["ground"], self.sight_dist)]), {}


StepsUp = task_env("StepsUp", "UpStepper-v0", StairsBase)
StepsDown = task_env("StepsDown", "DownStepper-v0", StairsBase)
WalkingBumpy = task_env("WalkingBumpy", "ObstacleTraverser-v0", StairsBase)
WalkingBumpy2 = task_env("WalkingBumpy2", "ObstacleTraverser-v1", StairsBase)
VerticalBarrier = task_env("VerticalBarrier", "Hurdler-v0", StairsBase)
FloatingPlatform = task_env("FloatingPlatform", "PlatformJumper-v0", StairsBase)
Gaps = task_env("Gaps", "GapJumper-v0", StairsBase)
BlockSoup = task_env("BlockSoup", "Traverser-v0", StairsBase)
