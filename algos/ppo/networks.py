"""Many of rsl-rl's networks side by side, with one batched matrix product per layer, and their action distributions."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any

import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules import EmpiricalNormalization, GaussianDistribution
from tensordict import TensorDict
from torch import nn
from torch.autograd.function import once_differentiable

from warpvox.algos.policies.network import HALF_LOG_2PI, observations

MOMENTS = ("_mean", "_var", "_std")


def tanh_layers(inputs: torch.Tensor, weights: Sequence[torch.Tensor], biases: Sequence[torch.Tensor]) -> torch.Tensor:
    """Return the outputs ``[networks, rows, outputs]`` of layers with tanh after each but the last.

    One autograd node in place of one for each operation, which overwrites what is not needed any more: small networks
    are limited by memory on a CPU. In float32 tanh is within 2e-7 of torch's.

    Args:
        inputs: ``[networks, rows, inputs]``.
        weights: ``[networks, inputs, outputs]`` of each layer.
        biases: ``[networks, 1, outputs]``.
    """
    return _TanhLayers.apply(inputs, *weights, *biases)


class _TanhLayers(torch.autograd.Function):
    """Autograd function of :func:`tanh_layers`."""

    @staticmethod
    def forward(ctx: Any, inputs: torch.Tensor, *parameters: torch.Tensor) -> torch.Tensor:
        """Compute the outputs and save the activations of each layer."""
        count = len(parameters) // 2
        weights = parameters[:count]
        biases = parameters[count:]
        one = inputs.new_ones(())
        values = [inputs]
        for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
            # tanh x = 1 - 2 sigmoid(-2 x), of which the sigmoid takes a tenth of the time of torch's tanh
            out = torch.baddbmm(bias, values[-1], weight, beta=-2, alpha=-2).sigmoid_()
            values.append(torch.sub(one, out, alpha=2, out=out))
        ctx.save_for_backward(*values, *weights)
        return torch.baddbmm(biases[-1], values[-1], weights[-1])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        """Return the gradients by weights and biases; there is none by the inputs."""
        count = len(ctx.saved_tensors) // 2
        values = ctx.saved_tensors[:count]
        weights = ctx.saved_tensors[count:]
        of_weights = []
        of_biases = []
        for k in reversed(range(count)):
            of_weights.append(values[k].mT @ gradient)
            of_biases.append(gradient.sum(-2, keepdim=True))
            if k:
                gradient = gradient @ weights[k].mT
                torch.ops.aten.tanh_backward.grad_input(gradient, values[k], grad_input=gradient)
        return None, *reversed(of_weights), *reversed(of_biases)


class StackedGaussian(nn.Module):
    """Gaussian action distributions with a logarithmic deviation, one for each design's policy.

    Deviations, their logarithms and the entropy are computed once per action instead of once per action and sample.

    Args:
        log_std: logarithms of the deviations, ``[designs, 1, actions]``.
        mask: 1 for actions, 0 where they are padded: a padded action is always at its mean.
    """

    mask: torch.Tensor

    def __init__(self, log_std: torch.Tensor, mask: torch.Tensor, limits: Sequence[float]) -> None:
        super().__init__()
        self.log_std_param = nn.Parameter(log_std)
        self.limits = limits
        self.register_buffer("mask", mask, persistent=False)

    def part(self, share: slice) -> StackedGaussian:
        """Return the distributions of neighbouring designs, which share this one's memory."""
        part = copy.copy(self)
        log_std = nn.Parameter(self.log_std_param.data[share])
        part._parameters = {"log_std_param": log_std}
        part._buffers = {"mask": self.mask[share]}
        return part

    def keep(self, rows: Sequence[int], outputs: int) -> None:
        """Keep the designs with the indices ``rows``, and the first ``outputs`` actions."""
        self.log_std_param.data = self.log_std_param.data[rows, :, :outputs]
        self.mask = self.mask[rows, :, :outputs]

    def update(self, mean: torch.Tensor) -> None:
        """Set the means to ``mean`` ``[designs, rows, actions]``, and the deviations to the parameters'."""
        self.mean = mean
        self._log_std = self.log_std_param.clamp(*self.limits)
        self.std = self._log_std.exp()

    @property
    def entropy(self) -> torch.Tensor:
        """Entropy of each design's distribution, ``[designs]``."""
        return self._sum(0.5 + HALF_LOG_2PI)[..., 0]

    def gradient(self, of_log_std: torch.Tensor, entropy_coef: float) -> torch.Tensor:
        """Return the gradient by :attr:`log_std_param` of a loss minus ``entropy_coef`` times the entropy.

        ``of_log_std`` ``[designs, rows, actions]``: the gradient by the logarithms of the deviations of each row.
        """
        low, high = self.limits
        is_free = (self.log_std_param >= low) & (self.log_std_param <= high)
        return of_log_std.sum(-2, keepdim=True).sub_(entropy_coef).mul_(is_free * self.mask)

    def log_prob(self, actions: torch.Tensor) -> torch.Tensor:
        """Return the log-probabilities ``[designs, rows]`` of actions ``[designs, rows, actions]``."""
        return self.log_prob_of(((actions - self.mean) / self.std).square())

    def log_prob_of(self, squares: torch.Tensor) -> torch.Tensor:
        """Return log-probabilities ``[designs, rows]`` from squared distances to the mean, in deviations."""
        return squares.sum(-1) * -0.5 - self._sum(HALF_LOG_2PI)

    def _sum(self, constant: float) -> torch.Tensor:
        """Return the sum over real actions of ``constant`` plus the logarithm of the deviation."""
        return ((self._log_std + constant) * self.mask).sum(-1)

    def mean_divergence(self, old_mean: torch.Tensor, old_std: torch.Tensor) -> torch.Tensor:
        """Return KL(old || current) averaged over the rows, ``[designs]``, from an old mean and deviation.

        Terms are added in torch's order, so that changes too small for it are exactly 0 here, too.
        """
        ratio = (old_std / self.std).square()
        terms = (old_mean - self.mean).div_(self.std).square_().add_(ratio).sub_(1).sub_(ratio.log())
        return terms.sum((-2, -1)) * (0.5 / terms.shape[-2])


class Normalizer(EmpiricalNormalization):
    """rsl-rl's normaliser of observations, with moments for each design."""

    count: torch.Tensor

    def update(self, x: torch.Tensor) -> None:
        """Update the moments by observations ``[designs, rows, entries]``."""
        mean = x.mean(-2, keepdim=True)
        var = (x - mean).square_().mean(-2, keepdim=True)
        self.count += x.shape[-2]
        rate = x.shape[-2] / self.count
        moved = mean - self._mean
        self._mean += rate * moved
        self._var += rate * (var - self._var + moved * (mean - self._mean))
        self._std.copy_(self._var.sqrt())


class PopulationModel(MLPModel):
    """Networks of one architecture, one for each design; sizes of inputs and outputs may differ.

    Rows of observations and results are sorted by design, in blocks of one size. Observations and actions are padded
    to those of the largest design with 0, and so are the weights of padded inputs and outputs; these stay 0, because
    their gradients are 0.
    """

    def __init__(self, models: Sequence[MLPModel]) -> None:
        nn.Module.__init__(self)
        first = models[0]
        self.obs_groups = first.obs_groups
        layers = [[layer for layer in model.mlp if isinstance(layer, nn.Linear)] for model in models]
        self.inputs = [row[0].in_features for row in layers]
        self.outputs = [row[-1].out_features for row in layers]
        self.activation = next(layer for layer in first.mlp if not isinstance(layer, nn.Linear))
        self.weights = nn.ParameterList()
        self.biases = nn.ParameterList()
        for column in zip(*layers, strict=True):
            self.weights.append(nn.Parameter(_padded([layer.weight.T for layer in column])))
            self.biases.append(nn.Parameter(_padded([layer.bias[None] for layer in column])))
        self.obs_normalizer: nn.Module = nn.Identity()
        if sources := [one for model in models if isinstance(one := model.obs_normalizer, EmpiricalNormalization)]:
            self.obs_normalizer = Normalizer(1, sources[0].eps)
            for name in MOMENTS:
                padding = 0.0 if name == "_mean" else 1.0
                setattr(self.obs_normalizer, name, _padded([getattr(source, name) for source in sources], padding))
            self.obs_normalizer.count = torch.stack([source.get_buffer("count") for source in sources])[:, None, None]

    @property
    def num_designs(self) -> int:
        return len(self.inputs)

    def scaled(self, obs: torch.Tensor) -> torch.Tensor:
        """Group observations ``[..., num_obs]`` by design and normalise them: ``[designs, rows, num_obs]``."""
        obs = obs.reshape(self.num_designs, -1, obs.shape[-1])
        return self.obs_normalizer(obs)

    def run(self, latent: torch.Tensor) -> torch.Tensor:
        """Return the outputs ``[designs, rows, outputs]`` of the networks for normalised inputs."""
        if latent.device.type == "cpu" and type(self.activation) is nn.Tanh:
            return tanh_layers(latent, list(self.weights), list(self.biases))
        return self.run_layers(latent, list(self.weights), list(self.biases))

    def run_layers(
        self, latent: torch.Tensor, weights: Sequence[torch.Tensor], biases: Sequence[torch.Tensor]
    ) -> torch.Tensor:
        """Return the outputs ``[networks, rows, outputs]`` of layers with the model's activation between them."""
        last = len(weights) - 1
        for k, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
            latent = torch.baddbmm(bias, latent, weight)
            if k < last:
                latent = self.activation(latent)
        return latent

    def forward(self, obs: TensorDict) -> torch.Tensor:
        """Return the outputs of all rows: ``[rows, actions]`` of a policy, ``[rows, 1]`` of a value function."""
        return self.run(self.scaled(observations(self, obs))).flatten(0, 1)

    def member(self, design: int) -> dict[str, torch.Tensor]:
        """Return a copy of one design's state, on the CPU, as a stock model loads it."""
        state = self.moments(design) | self.of_parameters(design, lambda parameter: parameter.detach())
        return {k: v.cpu().clone(memory_format=torch.contiguous_format) for k, v in state.items()}

    def moments(self, design: int) -> dict[str, torch.Tensor]:
        """Return views of one design's observation moments, by a stock model's names."""
        state: dict[str, torch.Tensor] = {}
        if isinstance(self.obs_normalizer, Normalizer):
            for name in MOMENTS:
                values = getattr(self.obs_normalizer, name)
                state[f"obs_normalizer.{name}"] = values[design, :, : self.inputs[design]]
            state["obs_normalizer.count"] = self.obs_normalizer.count[design, 0, 0]
        return state

    def of_parameters(self, design: int, values: Callable[[torch.Tensor], torch.Tensor]) -> dict[str, torch.Tensor]:
        """Return views of values for one design's parameters, by a stock model's names and in its shapes.

        Args:
            values: of a parameter what belongs to it, in its shape: itself, or its moments for instance.
        """
        inputs = self.inputs[design]
        outputs = self.outputs[design]
        last = len(self.weights) - 1
        state: dict[str, torch.Tensor] = {}
        for k, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            rows = slice(inputs if k == 0 else None)
            columns = slice(outputs if k == last else None)
            state[f"mlp.{2 * k}.weight"] = values(weight)[design, rows, columns].T
            state[f"mlp.{2 * k}.bias"] = values(bias)[design, 0, columns]
        return state

    def part(self, share: slice) -> PopulationModel:
        """Return a model of neighbouring designs that shares this one's memory."""
        part = copy.copy(self)
        part.inputs = self.inputs[share]
        part.outputs = self.outputs[share]
        # `.data` and not `.detach()`: what other threads write to their share must not look like a change of this one
        part._modules = {
            "activation": self.activation,
            "weights": nn.ParameterList(nn.Parameter(values.data[share]) for values in self.weights),
            "biases": nn.ParameterList(nn.Parameter(values.data[share]) for values in self.biases),
        }
        part.obs_normalizer = copy.copy(self.obs_normalizer)
        if isinstance(self.obs_normalizer, Normalizer):
            part.obs_normalizer._buffers = {name: value[share] for name, value in self.obs_normalizer.named_buffers()}
        return part

    def keep(self, index: Sequence[int]) -> None:
        """Keep the designs with the indices ``index``, in this order; parameters remain the same objects."""
        self.inputs, self.outputs = [[sizes[d] for d in index] for sizes in (self.inputs, self.outputs)]
        inputs = max(self.inputs)
        outputs = max(self.outputs)
        rows = list(index)
        for parameter in (*self.weights, *self.biases):
            parameter.data = parameter.data[rows]
        self.weights[0].data = self.weights[0].data[:, :inputs]
        for last in (self.weights[-1], self.biases[-1]):
            last.data = last.data[..., :outputs]
        if isinstance(self.obs_normalizer, Normalizer):
            for name in MOMENTS:
                setattr(self.obs_normalizer, name, getattr(self.obs_normalizer, name)[rows, :, :inputs])
            self.obs_normalizer.count = self.obs_normalizer.count[rows]


class PopulationActor(PopulationModel):
    """Policies of all designs, with the distributions of their actions."""

    distribution: StackedGaussian

    def __init__(self, models: Sequence[MLPModel]) -> None:
        super().__init__(models)
        gaussians = [one for model in models if isinstance(one := model.distribution, GaussianDistribution)]
        log_std = [one.log_std_param[None] for one in gaussians]
        mask = _padded([torch.ones_like(one) for one in log_std])
        self.distribution = StackedGaussian(_padded(log_std), mask, gaussians[0].log_std_range)

    def of_parameters(self, design: int, values: Callable[[torch.Tensor], torch.Tensor]) -> dict[str, torch.Tensor]:
        """Return views of values for one design's parameters, those of the distribution included."""
        own = values(self.distribution.log_std_param)[design, 0, : self.outputs[design]]
        return super().of_parameters(design, values) | {"distribution.log_std_param": own}

    def keep(self, index: Sequence[int]) -> None:
        super().keep(index)
        self.distribution.keep(list(index), max(self.outputs))


def _padded(parts: Sequence[torch.Tensor], padding: float = 0.0) -> torch.Tensor:
    """Stack matrices of different sizes into one tensor, padded with ``padding``."""
    rows, columns = (max(part.shape[axis] for part in parts) for axis in (0, 1))
    whole = parts[0].new_full((len(parts), rows, columns), padding).detach()
    for place, part in zip(whole, parts, strict=True):
        place[: part.shape[0], : part.shape[1]] = part.detach()
    return whole
