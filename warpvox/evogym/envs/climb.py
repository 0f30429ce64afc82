"""Climbing, under the names of EvoGym's module ``evogym.envs.climb``."""

from typing import Any

import numpy as np

from warpvox.evogym.envs.base import BenchmarkBase
from warpvox.evogym.envs.task import task_env

__all__ = ["Climb0", "Climb1", "Climb2", "ClimbBase"]


class ClimbBase(BenchmarkBase):
    """Base class of tasks that observe the robot's velocity and points."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Begin an episode; return the observed velocity and points, and an empty dictionary."""
        super().reset(seed=seed, options=options)
        return np.concatenate([self.get_vel_com_obs("robot"), self.get_relative_pos_obs("robot")]), {}


Climb0 = task_env("Climb0", "Climber-v0", ClimbBase)
Climb1 = task_env("Climb1", "Climber-v1", ClimbBase)
Climb2 = task_env("Climb2", "Climber-v2", ClimbBase)
