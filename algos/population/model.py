"""Many of rsl-rl's networks side by side: one batched matrix product a layer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch import nn

from warpvox.algos.training.layers import tanh_layers

__all__ = ["WIDTH", "PopulationModel", "width_for"]

WIDTH = 32
"""Outputs are padded to a multiple of this many columns.

It fills vector registers, and does not depend on who else is in the batch. The number of inputs does: a design's
numbers are the same bits in the same batch, and the same up to rounding in another.
"""
HALF_LOG_2PI = 0.5 * math.log(2 * math.pi)


def width_for(cells: int) -> int:
    """Columns for the actions of bodies with so many cells: those of the largest body of a grid, see :data:`WIDTH`."""
    return -(-cells // WIDTH) * WIDTH


class PopulationModel(nn.Module):
    """Stacks stock models of one architecture and speaks rsl-rl's interface of models.

    Rows of observations and results are sorted by design, in blocks of one size. Observations are padded with 0,
    and so are the weights of padded inputs and outputs; neither ever moves away from 0, because their gradients
    are 0.

    Args:
        models: one for each design; sizes of inputs and outputs may differ.
        width: columns of the last layer; a multiple of :data:`WIDTH`.

    Attributes:
        inputs, outputs: sizes of the stacked models.
        width: columns of the last layer.
        sampler: gives standard normal numbers ``[designs, rows, width]`` for a number of rows.
    """

    is_recurrent = False

    def __init__(self, models: Sequence[MLPModel], width: int) -> None:
        super().__init__()
        first = models[0]
        self.obs_groups, self.width, self.sampler = first.obs_groups, width, None
        layers = [[layer for layer in model.mlp if isinstance(layer, nn.Linear)] for model in models]
        self.inputs = [row[0].in_features for row in layers]
        self.outputs = [row[-1].out_features for row in layers]
        self.activation = next(layer for layer in first.mlp if not isinstance(layer, nn.Linear))
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        last = len(layers[0]) - 1
        for k, column in enumerate(zip(*layers, strict=True)):
            rows = max(self.inputs) if k == 0 else column[0].in_features
            columns = width if k == last else column[0].out_features
            self.weights.append(_stacked([layer.weight.detach().T for layer in column], rows, columns))
            self.biases.append(_stacked([layer.bias.detach()[None] for layer in column], 1, columns))
        self.log_std, self._range = None, None
        if first.distribution is not None:
            self.log_std = _stacked([model.distribution.log_std_param.detach()[None] for model in models], 1, width)
            self._range = first.distribution.log_std_range
        self._make_normalizer(models)
        self._make_mask()
        self._mean = self._log_std = self._std = None

    def _make_normalizer(self, models: Sequence[MLPModel]) -> None:
        self.normalizes = models[0].obs_normalization
        if not self.normalizes:
            return
        sources = [model.obs_normalizer for model in models]
        self.eps = sources[0].eps
        for name, padding in (("mean", 0.0), ("var", 1.0), ("std", 1.0)):
            rows = [getattr(source, f"_{name}") for source in sources]
            self.register_buffer(name, _padded(rows, 1, max(self.inputs), padding))
        self.register_buffer("count", torch.stack([source.count for source in sources])[:, None, None])

    def _make_mask(self) -> None:
        real = torch.arange(self.width) < torch.tensor(self.outputs)[:, None]
        self.register_buffer("mask", real.to(self.weights[0])[:, None], persistent=False)

    @property
    def num_designs(self) -> int:
        """Number of stacked models."""
        return len(self.inputs)

    # ----------------------------------------------------------------- forward

    def latent(self, obs: torch.Tensor) -> torch.Tensor:
        """Observations ``[..., num_obs]``, sorted by design, as scaled inputs ``[designs, rows, num_obs]``."""
        obs = obs.reshape(self.num_designs, -1, obs.shape[-1])
        return (obs - self.mean) / (self.std + self.eps) if self.normalizes else obs

    def run(self, latent: torch.Tensor) -> torch.Tensor:
        """Scaled inputs to outputs ``[designs, rows, width]``."""
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
        """Rows of outputs: ``[rows, width]`` of a policy, ``[rows, 1]`` of a value function."""
        out = self.run(self.latent(self._observations(obs)))
        if self.log_std is None:
            return out[..., :1].flatten(0, 1)
        if stochastic_output:
            self.set_mean(out)
            out = self.sampler(out.shape[1]) * self._std + out
        return out.flatten(0, 1)

    def _observations(self, obs: TensorDict) -> torch.Tensor:
        groups = [obs[name] for name in self.obs_groups]
        return groups[0] if len(groups) == 1 else torch.cat(groups, dim=-1)

    # ------------------------------------------------------------ distribution

    def set_mean(self, mean: torch.Tensor) -> None:
        """Make ``mean`` ``[designs, rows, width]`` that of the distribution which the methods below are about."""
        self._mean = mean
        self._log_std = self.log_std.clamp(*self._range)
        self._std = self._log_std.exp()

    @property
    def output_std(self) -> torch.Tensor:
        """``[designs, 1, width]``; 1 where padded."""
        return self._std

    @property
    def output_mean(self) -> torch.Tensor:
        """The mean as rows."""
        return self._mean.flatten(0, 1)

    @property
    def output_entropy(self) -> torch.Tensor:
        """``[designs]``; it does not depend on the observation."""
        return ((self._log_std + (0.5 + HALF_LOG_2PI)) * self.mask).sum((1, 2))

    def log_prob(self, actions: torch.Tensor) -> torch.Tensor:
        """``[designs, rows]`` of actions ``[designs, rows, width]``; padded ones are at their mean and add nothing."""
        constant = ((self._log_std + HALF_LOG_2PI) * self.mask).sum(2)
        return -0.5 * ((actions - self._mean) / self._std).square().sum(2) - constant

    def mean_divergence(self, mean: torch.Tensor, std: torch.Tensor) -> torch.Tensor:
        """``[designs]``: the mean over the rows of KL(old || current), as
        :meth:`warpvox.algos.training.networks.Gaussian.mean_divergence` has it."""
        ratio = (std / self._std).square()
        terms = (mean - self._mean).div_(self._std).square_().add_(ratio).sub_(1).sub_(ratio.log())
        return terms.sum((1, 2)) * (0.5 / terms.shape[1])

    # -------------------------------------------------------------------- more

    def update_normalization(self, mean: torch.Tensor, var: torch.Tensor, rows: int) -> None:
        """Learn from the moments ``[designs, 1, num_obs]`` of so many rows, as rsl-rl's normaliser does."""
        if not self.normalizes:
            return
        self.count += rows
        rate = rows / self.count
        delta = mean - self.mean
        self.mean += rate * delta
        self.var += rate * (var - self.var + delta * (mean - self.mean))
        self.std = self.var.sqrt()

    def reset(self, dones: Any = None, hidden_state: Any = None) -> None:
        """Nothing: these networks remember nothing."""

    def get_hidden_state(self) -> None:
        """None: these networks remember nothing."""

    def member(self, design: int) -> dict[str, torch.Tensor]:
        """The state of one design's network as a stock model loads it, on the CPU."""
        inputs, outputs, state = self.inputs[design], self.outputs[design], {}
        if self.normalizes:
            for name in ("mean", "var", "std"):
                state[f"obs_normalizer._{name}"] = getattr(self, name)[design, :, :inputs]
            state["obs_normalizer.count"] = self.count[design, 0, 0]
        if self.log_std is not None:
            state["distribution.log_std_param"] = self.log_std[design, 0, :outputs]
        last = len(self.weights) - 1
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            columns = slice(outputs if k == last else None)
            rows = slice(inputs if k == 0 else None)
            state[f"mlp.{2 * k}.weight"] = weight[design, rows, columns].T
            state[f"mlp.{2 * k}.bias"] = bias[design, 0, columns]
        return {
            name: value.detach().cpu().clone(memory_format=torch.contiguous_format) for name, value in state.items()
        }

    def part(self, share: slice) -> PopulationModel:
        """Some neighbouring designs as a model that learns in this one's memory, for already scaled inputs."""
        # `.data` and not `.detach()`: what others write to their share must not look like a change of this one
        part = object.__new__(PopulationModel)
        nn.Module.__init__(part)
        part.inputs, part.outputs, part.width = self.inputs[share], self.outputs[share], self.width
        part.activation, part.normalizes, part._range = self.activation, False, self._range
        part.weights = nn.ParameterList(nn.Parameter(weight.data[share]) for weight in self.weights)
        part.biases = nn.ParameterList(nn.Parameter(bias.data[share]) for bias in self.biases)
        part.log_std = None if self.log_std is None else nn.Parameter(self.log_std.data[share])
        part.register_buffer("mask", self.mask[share], persistent=False)
        return part

    def keep(self, index: Sequence[int]) -> None:
        """Only these designs go on, in this order; parameters remain the same objects."""
        rows = torch.as_tensor(list(index), device=self.mask.device)
        self.inputs, self.outputs = [[sizes[d] for d in index] for sizes in (self.inputs, self.outputs)]
        for parameter in self.parameters():
            parameter.data, parameter.grad = parameter.data[rows], None
        first = self.weights[0]
        first.data = first.data[:, : max(self.inputs)].contiguous()
        if self.normalizes:
            for name in ("mean", "var", "std"):
                setattr(self, name, getattr(self, name)[rows, :, : max(self.inputs)].contiguous())
            self.count = self.count[rows]
        self._make_mask()


def _stacked(parts: Sequence[torch.Tensor], rows: int, columns: int) -> nn.Parameter:
    return nn.Parameter(_padded(parts, rows, columns, 0.0))


def _padded(parts: Sequence[torch.Tensor], rows: int, columns: int, padding: float) -> torch.Tensor:
    whole = torch.full((len(parts), rows, columns), padding, dtype=parts[0].dtype, device=parts[0].device)
    for place, part in zip(whole, parts, strict=True):
        place[: part.shape[0], : part.shape[1]] = part
    return whole
