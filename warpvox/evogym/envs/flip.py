"""Flipping, under the names of EvoGym's module ``evogym.envs.flip``."""

from warpvox.evogym.envs.task import task_env

__all__ = ["Flipping"]

Flipping = task_env("Flipping", "Flipper-v0")
