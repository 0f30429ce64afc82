"""Jumping, under the names of EvoGym's module ``evogym.envs.jump``."""

from warpvox.evogym.envs.task import task_env

__all__ = ["StationaryJump"]

StationaryJump = task_env("StationaryJump", "Jumper-v0")
