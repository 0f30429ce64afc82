"""Balancing, under the names of EvoGym's module ``evogym.envs.balance``."""

from __future__ import annotations

from warpvox.evogym.envs.task import TaskEnv

__all__ = ["Balance", "BalanceJump"]


class Balance(TaskEnv):
    """Balancer-v0."""

    task = "Balancer-v0"


class BalanceJump(TaskEnv):
    """Balancer-v1."""

    task = "Balancer-v1"
