"""Gaussian distributions of actions; of bodies that differ with a deviation for each type of actuator, and masked."""

from __future__ import annotations

import math
from typing import Any

import torch
from rsl_rl.modules import GaussianDistribution

__all__ = ["HALF_LOG_2PI", "KINDS", "Gaussian", "VoxelGaussian"]

HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)

KINDS = 2
"""Types of actuators, horizontal and vertical: each has a deviation."""


class Gaussian(GaussianDistribution):
    """rsl-rl's distribution that draws nothing while learning, where rsl-rl's PPO drops what is drawn."""

    def sample(self) -> torch.Tensor:
        """``[rows, actions]``: drawn, or the mean where gradients are wanted."""
        return self.mean if torch.is_grad_enabled() else super().sample()


class VoxelGaussian(GaussianDistribution):
    """A Gaussian distribution of the actions that a body has.

    Actions that a body has not are 0 and take no part: nothing is drawn for them, and they add nothing to likelihood,
    entropy, divergence or gradients. :meth:`look` says, before :meth:`update`, which actions there are: a
    model calls it when it scales observations and when it runs.
    """

    def __init__(self, output_dim: int, **settings: Any) -> None:
        super().__init__(KINDS, **settings)
        self.output_dim = output_dim

    def look(self, kinds: torch.Tensor) -> None:
        """``kinds`` ``[rows, actions]``: 0: the body has no such action, 1: horizontal, 2: vertical actuator."""
        self._is_present, self._present = kinds > 0, kinds.clamp(max=1)
        self._vertical = kinds - self._present

    def by_kind(self, values: torch.Tensor, absent: float) -> torch.Tensor:
        """Values ``[kinds]`` by action, ``[rows, actions]``."""
        horizontal, vertical = values.to(self._vertical.dtype).unbind()
        of_actions = torch.lerp(
            horizontal.expand_as(self._vertical), vertical.expand_as(self._vertical), self._vertical
        )
        return torch.where(self._is_present, of_actions, absent)

    def update(self, mlp_output: torch.Tensor) -> None:
        """Make ``mlp_output`` ``[rows, actions]`` the mean; what it says of absent actions does not matter."""
        self._mean = torch.where(self._is_present, mlp_output, 0.0)
        self._log_std = self.by_kind(self.log_std_param.clamp(*self.log_std_range), 0.0)
        self._std = self._log_std.exp()

    def sample(self) -> torch.Tensor:
        """As :meth:`Gaussian.sample`."""
        if torch.is_grad_enabled():
            return self._mean
        return torch.where(self._is_present, torch.randn_like(self._mean).mul_(self._std).add_(self._mean), 0.0)

    @property
    def mean(self) -> torch.Tensor:
        """``[rows, actions]``."""
        return self._mean

    @property
    def std(self) -> torch.Tensor:
        """``[rows, actions]``, 1 for absent actions."""
        return self._std

    @property
    def entropy(self) -> torch.Tensor:
        """``[rows]``."""
        return ((self._log_std + (0.5 + HALF_LOG_2PI)) * self._present).sum(-1)

    def log_prob(self, outputs: torch.Tensor) -> torch.Tensor:
        """``[rows]`` of actions ``[rows, actions]``."""
        squares = ((outputs - self._mean) / self._std).square()
        return -((squares * 0.5 + self._log_std + HALF_LOG_2PI) * self._present).sum(-1)
