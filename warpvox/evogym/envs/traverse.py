"""Uneven terrain, under the names of EvoGym's module ``evogym.envs.traverse``."""

from __future__ import annotations

from typing import Any

import numpy as np

from warpvox.evogym.envs.base import BenchmarkBase
from warpvox.evogym.envs.task import TaskEnv

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
    """Base of tasks on terrain named ``ground``; a subclass sets ``sight_dist``, how far to the sides it is seen."""

    def get_reward(self, robot_pos_init: np.ndarray, robot_pos_final: np.ndarray) -> float:
        """How far the centre of mass of points ``[2, n]`` has moved along x."""
        return np.mean(robot_pos_final[0]) - np.mean(robot_pos_init[0])

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Begin an episode. Returns velocity, orientation, points and floor of the robot, and an empty dictionary."""
        super().reset(seed=seed, options=options)
        parts = [self.get_vel_com_obs("robot"), self.get_ort_obs("robot"), self.get_relative_pos_obs("robot")]
        return np.concatenate([*parts, self.get_floor_obs("robot", ["ground"], self.sight_dist)]), {}


class StepsUp(TaskEnv, StairsBase):
    """UpStepper-v0."""

    task = "UpStepper-v0"


class StepsDown(TaskEnv, StairsBase):
    """DownStepper-v0."""

    task = "DownStepper-v0"


class WalkingBumpy(TaskEnv, StairsBase):
    """ObstacleTraverser-v0."""

    task = "ObstacleTraverser-v0"


class WalkingBumpy2(TaskEnv, StairsBase):
    """ObstacleTraverser-v1."""

    task = "ObstacleTraverser-v1"


class VerticalBarrier(TaskEnv, StairsBase):
    """Hurdler-v0."""

    task = "Hurdler-v0"


class FloatingPlatform(TaskEnv, StairsBase):
    """PlatformJumper-v0."""

    task = "PlatformJumper-v0"


class Gaps(TaskEnv, StairsBase):
    """GapJumper-v0."""

    task = "GapJumper-v0"


class BlockSoup(TaskEnv, StairsBase):
    """Traverser-v0."""

    task = "Traverser-v0"
