"""Flipping, under the names of EvoGym's module ``evogym.envs.flip``."""

from __future__ import annotations

from warpvox.evogym.envs.task import TaskEnv

__all__ = ["Flipping"]


class Flipping(TaskEnv):
    """Flipper-v0."""

    task = "Flipper-v0"
