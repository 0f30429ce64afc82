"""Shape-changing tasks, under the names of EvoGym's module ``evogym.envs.change_shape``."""

from typing import Any

import numpy as np

from warpvox.evogym.envs.base import BenchmarkBase
from warpvox.evogym.envs.task import task_env

__all__ = ["MaximizeShape", "MaximizeXShape", "MaximizeYShape", "MinimizeShape", "ShapeBase"]


class ShapeBase(BenchmarkBase):
    """Base class of tasks that observe the robot's points, with helpers for convex hulls."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        """Begin an episode; return the observed points and an empty dictionary."""
        super().reset(seed=seed, options=options)
        return self.get_relative_pos_obs("robot"), {}

    def CCW(self, p1: np.ndarray, p2: np.ndarray, p3: np.ndarray) -> bool:
        """Return whether the path through three points turns left or goes straight on."""
        return bool((p2[0] - p1[0]) * (p3[1] - p1[1]) - (p2[1] - p1[1]) * (p3[0] - p1[0]) >= 0)

    def jarvis_march(self, S: np.ndarray) -> np.ndarray:
        """Return the corners ``[k, 2]`` of the convex hull of points ``[n, 2]``, counter-clockwise."""
        from scipy.spatial import ConvexHull

        points = np.asarray(S)
        return points[ConvexHull(points).vertices]

    def convex_poly_area(self, pts_cw: np.ndarray) -> float:
        """Return the area of a polygon ``[k, 2]``, positive if counter-clockwise."""
        x, y = np.transpose(pts_cw)
        u, v = np.transpose(np.roll(pts_cw, -1, axis=0))
        return float(np.sum(x * v - u * y)) / 2


MaximizeShape = task_env("MaximizeShape", "AreaMaximizer-v0", ShapeBase)
MinimizeShape = task_env("MinimizeShape", "AreaMinimizer-v0", ShapeBase)
MaximizeXShape = task_env("MaximizeXShape", "WingspanMaximizer-v0", ShapeBase)
MaximizeYShape = task_env("MaximizeYShape", "HeightMaximizer-v0", ShapeBase)
