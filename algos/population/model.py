"""Many of rsl-rl's networks side by side: one batched matrix product a layer."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any

import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules import EmpiricalNormalization
from tensordict import TensorDict
from torch import nn

from warpvox.algos.policies.network import observations
from warpvox.algos.population.gaussian import StackedGaussian
from warpvox.algos.population.layers import tanh_layers

MOMENTS = ("_mean", "_var", "_std")


class Normalizer(EmpiricalNormalization):
    """rsl-rl's normaliser of observations, for many designs."""

    def update(self, x: torch.Tensor) -> None:
        """Learn from observations ``[designs, rows, entries]``."""
        mean = x.mean(-2, keepdim=True)
        var = (x - mean).square_().mean(-2, keepdim=True)
        self.count += x.shape[-2]
        rate, moved = x.shape[-2] / self.count, mean - self._mean
        self._mean += rate * moved
        self._var += rate * (var - self._var + moved * (mean - self._mean))
        self._std = self._var.sqrt()


class PopulationModel(nn.Module):
    """Stacks stock models of one architecture and has rsl-rl's interface of models.

    Rows of observations and results are sorted by design, in blocks of one size. Observations and actions are padded
    to those of the largest design with 0, and so are the weights of padded inputs and outputs; these stay 0, because
    their gradients are 0.

    Args:
        models: one for each design; sizes of inputs and outputs may differ.
        noise: gives standard normal numbers ``[designs, rows, actions]`` for a number of rows; 0 where padded.

    Attributes:
        distribution: of the actions; None: these are value functions.
    """

    is_recurrent = False

    def __init__(self, models: Sequence[MLPModel], noise: Callable[[int], torch.Tensor] | None = None) -> None:
        super().__init__()
        first = models[0]
        self.obs_groups, self.noise, self.distribution = first.obs_groups, noise, None
        layers = [[layer for layer in model.mlp if isinstance(layer, nn.Linear)] for model in models]
        self.inputs = [row[0].in_features for row in layers]
        self.outputs = [row[-1].out_features for row in layers]
        self.activation = next(layer for layer in first.mlp if not isinstance(layer, nn.Linear))
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        for column in zip(*layers, strict=True):
            self.weights.append(nn.Parameter(_padded([layer.weight.T for layer in column])))
            self.biases.append(nn.Parameter(_padded([layer.bias[None] for layer in column])))
        if first.distribution is not None:
            log_std = [model.distribution.log_std_param[None] for model in models]
            mask = _padded([torch.ones_like(one) for one in log_std])
            self.distribution = StackedGaussian(_padded(log_std), mask, first.distribution.log_std_range)
        self.obs_normalizer: nn.Module = nn.Identity()
        if first.obs_normalization:
            sources = [model.obs_normalizer for model in models]
            self.obs_normalizer = Normalizer(1, sources[0].eps)
            for name in MOMENTS:
                padding = 0.0 if name == "_mean" else 1.0
                setattr(self.obs_normalizer, name, _padded([getattr(source, name) for source in sources], padding))
            self.obs_normalizer.count = torch.stack([source.count for source in sources])[:, None, None]

    @property
    def num_designs(self) -> int:
        """Number of stacked models."""
        return len(self.inputs)

    def scaled(self, obs: torch.Tensor) -> torch.Tensor:
        """Observations ``[..., num_obs]``, sorted by design, as inputs ``[designs, rows, num_obs]`` of the networks."""
        obs = obs.reshape(self.num_designs, -1, obs.shape[-1])
        return self.obs_normalizer(obs)

    def run(self, latent: torch.Tensor) -> torch.Tensor:
        """Scaled inputs to outputs ``[designs, rows, outputs]``."""
        if latent.device.type == "cpu" and type(self.activation) is nn.Tanh:
            return tanh_layers(latent, list(self.weights), list(self.biases))
        last = len(self.weights) - 1
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            latent = torch.baddbmm(bias, latent, weight)
            if k < last:
                latent = self.activation(latent)
        return latent

    def forward(
        self, obs: TensorDict, masks: Any = None, hidden_state: Any = None, stochastic_output: bool = False
    ) -> torch.Tensor:
        """Rows of outputs: ``[rows, actions]`` of a policy, ``[rows, 1]`` of a value function."""
        latent = self.scaled(observations(self, obs))
        if self.distribution is not None and stochastic_output:
            return self.sample(latent)
        return self.run(latent).flatten(0, 1)

    def sample(self, latent: torch.Tensor) -> torch.Tensor:
        """Actions ``[rows, actions]`` drawn for scaled inputs."""
        out = self.run(latent)
        self.distribution.update(out)
        return (self.noise(out.shape[1]) * self.distribution.std + out).flatten(0, 1)

    def reset(self, dones: Any = None, hidden_state: Any = None) -> None:
        """Nothing: these networks are not recurrent."""

    def get_hidden_state(self) -> None:
        """None: these networks are not recurrent."""

    def member(self, design: int) -> dict[str, torch.Tensor]:
        """The state of one design's network as a stock model loads it, on the CPU."""
        inputs, outputs, state = self.inputs[design], self.outputs[design], {}
        if isinstance(self.obs_normalizer, Normalizer):
            for name in MOMENTS:
                state[f"obs_normalizer.{name}"] = getattr(self.obs_normalizer, name)[design, :, :inputs]
            state["obs_normalizer.count"] = self.obs_normalizer.count[design, 0, 0]
        if self.distribution is not None:
            state["distribution.log_std_param"] = self.distribution.log_std_param[design, 0, :outputs]
        last = len(self.weights) - 1
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            columns = slice(outputs if k == last else None)
            state[f"mlp.{2 * k}.weight"] = weight[design, : inputs if k == 0 else None, columns].T
            state[f"mlp.{2 * k}.bias"] = bias[design, 0, columns]
        return {k: v.detach().cpu().clone(memory_format=torch.contiguous_format) for k, v in state.items()}

    def part(self, share: slice) -> PopulationModel:
        """Some neighbouring designs as a model that shares this one's memory."""
        part = copy.copy(self)
        part.inputs, part.outputs = self.inputs[share], self.outputs[share]
        # `.data` and not `.detach()`: what other threads write to their share must not look like a change of this one
        cut = lambda values: nn.Parameter(values.data[share])  # noqa: E731
        part._modules = self._modules | {
            "weights": nn.ParameterList(map(cut, self.weights)),
            "biases": nn.ParameterList(map(cut, self.biases)),
        }
        if self.distribution is not None:
            part.distribution = self.distribution.part(cut(self.distribution.log_std_param), share)
        if isinstance(self.obs_normalizer, Normalizer):
            part.obs_normalizer = copy.copy(self.obs_normalizer)
            part.obs_normalizer._buffers = {name: value[share] for name, value in self.obs_normalizer._buffers.items()}
        return part

    def keep(self, index: Sequence[int]) -> None:
        """Keep these designs, in this order; parameters remain the same objects."""
        self.inputs, self.outputs = [[sizes[d] for d in index] for sizes in (self.inputs, self.outputs)]
        inputs, outputs, rows = max(self.inputs), max(self.outputs), list(index)
        for parameter in (*self.weights, *self.biases):
            parameter.data = parameter.data[rows]
        self.weights[0].data = self.weights[0].data[:, :inputs]
        for last in (self.weights[-1], self.biases[-1]):
            last.data = last.data[..., :outputs]
        if self.distribution is not None:
            self.distribution.keep(rows, outputs)
        if isinstance(self.obs_normalizer, Normalizer):
            for name in MOMENTS:
                setattr(self.obs_normalizer, name, getattr(self.obs_normalizer, name)[rows, :, :inputs])
            self.obs_normalizer.count = self.obs_normalizer.count[rows]


def _padded(parts: Sequence[torch.Tensor], padding: float = 0.0) -> torch.Tensor:
    """Matrices of different sizes as one tensor."""
    rows, columns = (max(part.shape[axis] for part in parts) for axis in (0, 1))
    whole = parts[0].new_full((len(parts), rows, columns), padding).detach()
    for place, part in zip(whole, parts, strict=True):
        place[: part.shape[0], : part.shape[1]] = part.detach()
    return whole
