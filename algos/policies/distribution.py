"""The distribution of actions of bodies that differ: one deviation for each type of actuator, and masked actions."""

from __future__ import annotations

from typing import Any

import torch

from warpvox.algos.training.networks import HALF_LOG_2PI, Gaussian

__all__ = ["KINDS", "VoxelGaussian"]

KINDS = 2
"""Types of actuators, horizontal and vertical: each has a deviation."""


class VoxelGaussian(Gaussian):
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
        self._log_kinds = self.log_std_param.clamp(*self.log_std_range)
        self._log_std = self.by_kind(self._log_kinds, 0.0)
        self._std = self._log_std.exp()

    def sample(self) -> torch.Tensor:
        """``[rows, actions]``, without a gradient."""
        noise = torch.randn_like(self._mean).mul_(self._std)
        return torch.where(self._is_present, noise.add_(self._mean), 0.0).detach()

    @property
    def params(self) -> tuple[torch.Tensor, ...]:
        """Mean and deviation, ``[rows, actions]`` each: what rsl-rl keeps."""
        return self._mean, self._std

    @property
    def row_std(self) -> torch.Tensor:
        """``[rows, actions]``, 1 for absent actions."""
        return self._std

    @property
    def kept_std(self) -> torch.Tensor:
        """``[kinds]``: what :meth:`mean_divergence` needs of an earlier distribution."""
        return self._log_kinds.exp()

    @property
    def entropy(self) -> torch.Tensor:
        """``[rows]``."""
        return ((self._log_std + (0.5 + HALF_LOG_2PI)) * self._present).sum(-1)

    def log_prob(self, outputs: torch.Tensor) -> torch.Tensor:
        """``[rows]`` of actions ``[rows, actions]``."""
        outputs = torch.where(self._is_present, outputs, 0.0)
        return self.log_prob_of(((outputs - self._mean) / self._std).square())

    def log_prob_of(self, squares: torch.Tensor) -> torch.Tensor:
        """``[rows]`` of actions so many squared deviations from the mean, ``[rows, actions]``."""
        return -((squares * 0.5 + self._log_std + HALF_LOG_2PI) * self._present).sum(-1)

    def gradient(self, of_log_std: torch.Tensor, entropy_coef: float) -> torch.Tensor:
        """See :meth:`Gaussian.gradient`; ``[kinds]``."""
        of_log_std = (of_log_std - entropy_coef / len(of_log_std)) * self._present
        vertical = (of_log_std * self._vertical).sum()
        return torch.stack([of_log_std.sum() - vertical, vertical]) * self.std_is_free

    def mean_divergence(self, old_mean: torch.Tensor, old_std: torch.Tensor) -> torch.Tensor:
        """The mean over the rows of KL(old || current), from means ``[rows, actions]`` and :attr:`kept_std`."""
        old = self.by_kind(old_std, 1.0)
        ratio = (old / self._std).square()
        terms = (old_mean - self._mean).div_(self._std).square_().add_(ratio).sub_(1).sub_(ratio.log())
        return (terms * self._present).sum() * (0.5 / len(terms))
