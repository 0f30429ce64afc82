"""The Gaussian distributions of the actions of many policies, with gradients by hand."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import torch
from torch import nn

from warpvox.algos.policies.network import HALF_LOG_2PI


class StackedGaussian(nn.Module):
    """rsl-rl's distributions with a logarithmic deviation, of one policy for each design.

    Deviations, their logarithms and the entropy are computed once per action instead of once per action and sample.

    Args:
        log_std: logarithms of the deviations, ``[designs, 1, actions]``.
        mask: 1 for actions, 0 where they are padded: a padded action is always at its mean.
    """

    mask: torch.Tensor

    def __init__(self, log_std: torch.Tensor, mask: torch.Tensor, limits: Sequence[float]) -> None:
        super().__init__()
        self.log_std_param, self.limits = nn.Parameter(log_std), limits
        self.register_buffer("mask", mask, persistent=False)

    def part(self, log_std: nn.Parameter, share: slice) -> StackedGaussian:
        """Some neighbouring designs; ``log_std`` is theirs."""
        part = copy.copy(self)
        part._parameters, part._buffers = {"log_std_param": log_std}, {"mask": self.mask[share]}
        return part

    def keep(self, rows: Sequence[int], outputs: int) -> None:
        """Keep these designs, and so many actions."""
        self.log_std_param.data = self.log_std_param.data[rows, :, :outputs]
        self.mask = self.mask[rows, :, :outputs]

    def update(self, mean: torch.Tensor) -> None:
        """Make ``[designs, rows, actions]`` the mean."""
        self.mean, self._log_std = mean, self.log_std_param.clamp(*self.limits)
        self.std = self._log_std.exp()

    @property
    def entropy(self) -> torch.Tensor:
        """``[designs]``."""
        return self._sum(0.5 + HALF_LOG_2PI)[..., 0]

    def gradient(self, of_log_std: torch.Tensor, entropy_coef: float) -> torch.Tensor:
        """Gradient of a loss, less ``entropy_coef`` times the entropy, by :attr:`log_std_param`.

        ``of_log_std`` ``[designs, rows, actions]``: the gradient by the logarithms of the deviations of each row.
        """
        low, high = self.limits
        is_free = (self.log_std_param >= low) & (self.log_std_param <= high)
        return of_log_std.sum(-2, keepdim=True).sub_(entropy_coef).mul_(is_free * self.mask)

    def log_prob(self, actions: torch.Tensor) -> torch.Tensor:
        """``[designs, rows]`` of actions ``[designs, rows, actions]``."""
        return self.log_prob_of(((actions - self.mean) / self.std).square())

    def log_prob_of(self, squares: torch.Tensor) -> torch.Tensor:
        """``[designs, rows]`` of actions so many squared deviations from the mean."""
        return squares.sum(-1) * -0.5 - self._sum(HALF_LOG_2PI)

    def _sum(self, constant: float) -> torch.Tensor:
        return ((self._log_std + constant) * self.mask).sum(-1)

    def mean_divergence(self, old_mean: torch.Tensor, old_std: torch.Tensor) -> torch.Tensor:
        """``[designs]``: the mean over the rows of KL(old || current), from an earlier :attr:`mean` and :attr:`std`.

        Terms are added in torch's order, so that changes too small for it are exactly 0 here, too.
        """
        ratio = (old_std / self.std).square()
        terms = (old_mean - self.mean).div_(self.std).square_().add_(ratio).sub_(1).sub_(ratio.log())
        return terms.sum((-2, -1)) * (0.5 / terms.shape[-2])
