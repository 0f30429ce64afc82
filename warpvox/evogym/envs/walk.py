"""Walking, under the names of EvoGym's module ``evogym.envs.walk``."""

from __future__ import annotations

from warpvox.evogym.envs.task import TaskEnv

__all__ = ["Duck", "SoftBridge", "WalkingFlat"]


class WalkingFlat(TaskEnv):
    """Walker-v0."""

    task = "Walker-v0"


class SoftBridge(TaskEnv):
    """BridgeWalker-v0."""

    task = "BridgeWalker-v0"


class Duck(TaskEnv):
    """CaveCrawler-v0."""

    task = "CaveCrawler-v0"
