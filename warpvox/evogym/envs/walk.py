"""Walking, under the names of EvoGym's module ``evogym.envs.walk``."""

from warpvox.evogym.envs.task import task_env

__all__ = ["Duck", "SoftBridge", "WalkingFlat"]

WalkingFlat = task_env("WalkingFlat", "Walker-v0")
SoftBridge = task_env("SoftBridge", "BridgeWalker-v0")
Duck = task_env("Duck", "CaveCrawler-v0")
