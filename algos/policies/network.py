"""rsl-rl's fully connected network, faster on a CPU, and Gaussian action distributions."""

import math
from typing import Any

import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules import GaussianDistribution
from tensordict import TensorDict
from torch import nn
from torch.distributions import Normal
from torch.nn import functional

LATENT = "latent"
"""Name of the observation group with precomputed scaled inputs."""

HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)

KINDS = 2
"""Number of actuator types (horizontal, vertical); each has its own standard deviation."""


def observations(model: Any, obs: TensorDict) -> torch.Tensor:
    """Concatenate the observation groups of a model, ``[..., entries]``; a single group is not copied."""
    groups = [obs[name] for name in model.obs_groups]
    return groups[0] if len(groups) == 1 else torch.cat(groups, dim=-1)


class Network(MLPModel):
    """rsl-rl's MLP model, faster, with the same parameters and results up to float32 rounding."""

    def get_latent(self, obs: TensorDict, masks: object = None, hidden_state: object = None) -> torch.Tensor:
        """Return the scaled inputs ``[rows, inputs]``, precomputed in group :data:`LATENT` if present."""
        return obs[LATENT] if LATENT in obs else self.obs_normalizer(observations(self, obs))

    def run(self, latent: torch.Tensor) -> torch.Tensor:
        """Compute the outputs ``[rows, outputs]`` from scaled inputs."""
        layers = [layer for layer in self.mlp if isinstance(layer, nn.Linear)]
        is_tanh = all(type(layer) in (nn.Linear, nn.Tanh) for layer in self.mlp)
        if latent.device.type != "cpu" or latent.dtype != torch.float32 or not is_tanh:
            return self.mlp(latent)
        # tanh x = 1 - 2 sigmoid(-2 x): the sigmoid takes a tenth of the time of torch's tanh, and the factors are
        # merged into the weights of the layers before and after.
        values = latent
        for index, layer in enumerate(layers):
            weight = layer.weight
            bias = layer.bias
            if index:
                bias = bias + weight.sum(1)
                weight = -2 * weight
            if index < len(layers) - 1:
                values = functional.linear(values, -2 * weight, -2 * bias).sigmoid_()
        return functional.linear(values, weight, bias)

    def forward(
        self, obs: TensorDict, masks: object = None, hidden_state: object = None, stochastic_output: bool = False
    ) -> torch.Tensor:
        """Compute the outputs, or sample actions around the outputs if ``stochastic_output``."""
        out = self.run(self.get_latent(obs))
        if self.distribution is None or not stochastic_output:
            return out
        self.distribution.update(out)
        return self.distribution.sample()


class Gaussian(GaussianDistribution):
    """rsl-rl's Gaussian distribution without the unused random draws during updates.

    ``generator``: that it draws from; None: torch's own.
    """

    generator: torch.Generator | None = None

    def sample(self) -> torch.Tensor:
        """Return actions ``[rows, actions]``: random, or the mean while gradients are enabled."""
        return self.mean if torch.is_grad_enabled() else torch.normal(self.mean, self.std, generator=self.generator)


class VoxelGaussian(Gaussian):
    """Gaussian distribution over the actions of each body.

    Actions that a body has not are 0, with a deviation of 1, and take no part: nothing is drawn for them, and they add
    nothing to likelihood, entropy, divergence or gradients. :meth:`look` says, before :meth:`update`, which actions
    there are: a model calls it when it scales observations and when it runs.
    """

    def __init__(self, output_dim: int, **settings: Any) -> None:
        super().__init__(KINDS, **settings)
        self.output_dim = output_dim

    def look(self, kinds: torch.Tensor) -> None:
        """Set each action's kind, ``[rows, actions]``: 0 none, 1 horizontal, 2 vertical actuator."""
        self._is_present = kinds > 0
        self._present = kinds.clamp(max=1)
        self._vertical = kinds - self._present

    def by_kind(self, values: torch.Tensor) -> torch.Tensor:
        """Look up ``values`` ``[kinds]`` for each action, ``[rows, actions]``; 0 for absent actions."""
        horizontal, vertical = values.to(self._vertical.dtype).unbind()
        of_actions = torch.lerp(
            horizontal.expand_as(self._vertical), vertical.expand_as(self._vertical), self._vertical
        )
        return torch.where(self._is_present, of_actions, 0.0)

    def update(self, mlp_output: torch.Tensor) -> None:
        """Set the means to ``mlp_output`` ``[rows, actions]``; entries of absent actions are ignored."""
        self._log_std = self.by_kind(self.log_std_param.clamp(*self.log_std_range))
        self._distribution = Normal(torch.where(self._is_present, mlp_output, 0.0), self._log_std.exp())

    def sample(self) -> torch.Tensor:
        """Return actions ``[rows, actions]``: random, or the mean while gradients are enabled; 0 if absent."""
        if torch.is_grad_enabled():
            return self.mean
        noise = torch.empty_like(self.mean).normal_(generator=self.generator)
        return torch.where(self._is_present, noise.mul_(self.std).add_(self.mean), 0.0)

    @property
    def entropy(self) -> torch.Tensor:
        """Entropy of each row's distribution, ``[rows]``."""
        return ((self._log_std + (0.5 + HALF_LOG_2PI)) * self._present).sum(-1)

    def log_prob(self, outputs: torch.Tensor) -> torch.Tensor:
        """Compute the log-probabilities ``[rows]`` of actions ``[rows, actions]``."""
        squares = ((outputs - self.mean) / self.std).square()
        return -((squares * 0.5 + self._log_std + HALF_LOG_2PI) * self._present).sum(-1)
