"""rsl-rl's network and Gaussian distribution in fewer operations: the same parameters, equal up to rounding.

Shapes are given for one policy; of a stack (:mod:`warpvox.algos.population.model`) all have a first axis for designs.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules import EmpiricalNormalization, GaussianDistribution
from tensordict import TensorDict
from torch import nn

from warpvox.algos.training.layers import tanh_layers

__all__ = ["Gaussian", "Network", "Normalizer", "observations"]

HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)


class Gaussian(GaussianDistribution):
    """rsl-rl's Gaussian distribution with a logarithmic deviation that does not depend on the observation.

    Deviations, their logarithms and the entropy are computed once per action instead of once per action and sample.
    Samples are the same numbers as rsl-rl's.
    """

    mask: torch.Tensor | float = 1.0
    """1 for actions, 0 for columns that pad those of a stack; a padded action is always at its mean."""

    def update(self, mlp_output: torch.Tensor) -> None:
        """Make ``mlp_output`` ``[rows, actions]`` the mean."""
        self._mean = mlp_output
        self._log_std = self.log_std_param.clamp(*self.log_std_range)
        self._std = self._log_std.exp()

    def sample(self) -> torch.Tensor:
        """``[rows, actions]``, without a gradient."""
        return torch.randn_like(self._mean).mul_(self._std).add_(self._mean).detach()

    @property
    def mean(self) -> torch.Tensor:
        """``[rows, actions]``."""
        return self._mean

    @property
    def row_std(self) -> torch.Tensor:
        """``[actions]``: the deviation, which all rows share."""
        return self._std

    @property
    def std(self) -> torch.Tensor:
        """``[rows, actions]``."""
        return self._std.expand_as(self._mean)

    @property
    def entropy(self) -> torch.Tensor:
        """``[rows]``."""
        return self._sum(0.5 + HALF_LOG_2PI).expand(self._mean.shape[:-1])

    @property
    def kept_std(self) -> torch.Tensor:
        """``[actions]``: what :meth:`mean_divergence` needs of an earlier distribution."""
        return self._std

    @property
    def std_is_free(self) -> torch.Tensor:
        """bool ``[actions]``: where the deviation is within its bounds and follows its parameter."""
        low, high = self.log_std_range
        return (self.log_std_param >= low) & (self.log_std_param <= high)

    def gradient(self, of_log_std: torch.Tensor, entropy_coef: float) -> torch.Tensor:
        """Gradient of a loss, less ``entropy_coef`` times the entropy, by :attr:`log_std_param`, in its shape.

        ``of_log_std`` ``[rows, actions]``: the gradient by the logarithms of the deviations of each row.
        """
        total = of_log_std.sum(-2, keepdim=of_log_std.ndim == 3)
        return total.sub_(entropy_coef).mul_(self.std_is_free * self.mask)

    def log_prob(self, outputs: torch.Tensor) -> torch.Tensor:
        """``[rows]`` of actions ``[rows, actions]``."""
        return self.log_prob_of(((outputs - self._mean) / self._std).square())

    def log_prob_of(self, squares: torch.Tensor) -> torch.Tensor:
        """``[rows]`` of actions so many squared deviations from the mean, ``[rows, actions]``."""
        return squares.sum(-1) * -0.5 - self._sum(HALF_LOG_2PI)

    def _sum(self, constant: float) -> torch.Tensor:
        return ((self._log_std + constant) * self.mask).sum(-1)

    def mean_divergence(self, old_mean: torch.Tensor, old_std: torch.Tensor) -> torch.Tensor:
        """The mean over the rows of KL(old || current), from means ``[rows, actions]`` and a deviation ``[actions]``.

        Terms are added in torch's order, so that changes too small for it are exactly 0 here, too.
        """
        ratio = (old_std / self._std).square()
        terms = (old_mean - self._mean).div_(self._std).square_().add_(ratio).sub_(1).sub_(ratio.log())
        return terms.sum((-2, -1)) * (0.5 / terms.shape[-2])


class Normalizer(EmpiricalNormalization):
    """rsl-rl's normaliser of observations, whose variance takes a tenth of the time of ``torch.var``."""

    def update(self, x: torch.Tensor) -> None:
        """Learn from observations ``[rows, entries]``."""
        if torch.distributed.is_initialized():
            super().update(x)
        elif self.training:
            mean = x.mean(-2, keepdim=True)
            var = (x - mean).square_().mean(-2, keepdim=True)
            self.count += x.shape[-2]
            rate, moved = x.shape[-2] / self.count, mean - self._mean
            self._mean += rate * moved
            self._var += rate * (var - self._var + moved * (mean - self._mean))
            self._std = self._var.sqrt()


class Network(MLPModel):
    """rsl-rl's network of fully connected layers; in training layers with tanh are computed by :func:`tanh_layers`."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        if self.obs_normalization:
            self.obs_normalizer = Normalizer(self.obs_dim)

    def get_latent(self, obs: TensorDict, masks: object = None, hidden_state: object = None) -> torch.Tensor:
        """Observations as the scaled inputs of the first layer, ``[rows, inputs]``."""
        return self.scaled(observations(self, obs))

    def scaled(self, obs: torch.Tensor) -> torch.Tensor:
        """Observations ``[rows, inputs]`` as the inputs of the first layer."""
        return self.obs_normalizer(obs)

    def forward(
        self, obs: TensorDict, masks: object = None, hidden_state: object = None, stochastic_output: bool = False
    ) -> torch.Tensor:
        """As rsl-rl's."""
        if not self.training:
            return super().forward(obs, masks, hidden_state, stochastic_output)
        latent = self.get_latent(obs)
        return self.sample(latent) if self.distribution is not None and stochastic_output else self.run(latent)

    def sample(self, latent: torch.Tensor) -> torch.Tensor:
        """Actions ``[rows, actions]`` drawn for scaled inputs."""
        self.distribution.update(self.run(latent))
        return self.distribution.sample()

    def unpack(self, latent: torch.Tensor) -> torch.Tensor:
        """What actor and critic can share of scaled inputs: these as they are."""
        return latent

    def run(self, latent: torch.Tensor) -> torch.Tensor:
        """Scaled inputs to outputs."""
        layers = [layer for layer in self.mlp if isinstance(layer, nn.Linear)]
        if latent.device.type != "cpu" or not all(type(layer) in (nn.Linear, nn.Tanh) for layer in self.mlp):
            return self.mlp(latent)
        return tanh_layers(latent, [layer.weight.t() for layer in layers], [layer.bias for layer in layers])


def observations(model: Any, obs: TensorDict) -> torch.Tensor:
    """What a model observes, ``[..., entries]``, of the groups of ``obs``."""
    groups = [obs[name] for name in model.obs_groups]
    return groups[0] if len(groups) == 1 else torch.cat(groups, dim=-1)
