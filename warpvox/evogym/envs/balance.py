"""Balancing, under the names of EvoGym's module ``evogym.envs.balance``."""

from warpvox.evogym.envs.task import task_env

__all__ = ["Balance", "BalanceJump"]

Balance = task_env("Balance", "Balancer-v0")
BalanceJump = task_env("BalanceJump", "Balancer-v1")
