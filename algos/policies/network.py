"""rsl-rl's network of fully connected layers, faster on a CPU."""

from __future__ import annotations

from typing import Any

import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch import nn
from torch.nn import functional

__all__ = ["LATENT", "Network", "observations"]

LATENT = "latent"
"""Group of observations that holds the scaled inputs of a network, where they are known already."""


def observations(model: Any, obs: TensorDict) -> torch.Tensor:
    """What a model observes, ``[..., entries]``, of the groups of ``obs``."""
    return torch.cat([obs[name] for name in model.obs_groups], dim=-1)


class Network(MLPModel):
    """rsl-rl's network, with the same parameters and, but for rounding in float32, the same results."""

    def get_latent(self, obs: TensorDict, masks: object = None, hidden_state: object = None) -> torch.Tensor:
        """Scaled inputs ``[rows, inputs]``."""
        return obs[LATENT] if LATENT in obs else self.scaled(observations(self, obs))

    def scaled(self, obs: torch.Tensor) -> torch.Tensor:
        """What :meth:`run` takes, ``[rows, inputs]``, of observations ``[rows, num_obs]``."""
        return self.obs_normalizer(obs)

    def run(self, latent: torch.Tensor) -> torch.Tensor:
        """Scaled inputs to outputs ``[rows, outputs]``."""
        layers = [layer for layer in self.mlp if isinstance(layer, nn.Linear)]
        is_tanh = all(type(layer) in (nn.Linear, nn.Tanh) for layer in self.mlp)
        if latent.device.type != "cpu" or latent.dtype != torch.float32 or not is_tanh:
            return self.mlp(latent)
        # tanh x = 1 - 2 sigmoid(-2 x), of which the sigmoid takes a tenth of the time of torch's tanh; the rest of it
        # is part of the layers around
        values = latent
        for place, layer in enumerate(layers):
            weight, bias = layer.weight, layer.bias
            if place:
                weight, bias = -2 * weight, bias + weight.sum(1)
            if place < len(layers) - 1:
                values = functional.linear(values, -2 * weight, -2 * bias).sigmoid_()
        return functional.linear(values, weight, bias)

    def forward(
        self, obs: TensorDict, masks: object = None, hidden_state: object = None, stochastic_output: bool = False
    ) -> torch.Tensor:
        """As of rsl-rl's models."""
        out = self.run(self.get_latent(obs))
        if self.distribution is None or not stochastic_output:
            return out
        self.distribution.update(out)
        return self.distribution.sample()
