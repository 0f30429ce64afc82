"""Jumping, under the names of EvoGym's module ``evogym.envs.jump``."""

from __future__ import annotations

from warpvox.evogym.envs.task import TaskEnv

__all__ = ["StationaryJump"]


class StationaryJump(TaskEnv):
    """Jumper-v0."""

    task = "Jumper-v0"
