"""Policies of stored robots, evaluated so that every machine gets the same actions."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from warpvox.checks import check_choice
from warpvox.errors import RunError
from warpvox.types import ACTION_HIGH, ACTION_LOW

STEP = 2.0**-16
"""Actions are multiples of it.

How a matrix product or a tanh is rounded depends on the CPU and the libraries. Such differences are about 1e-15 and are
gone after rounding to a step that is 1e10 times as large, unless an action lies within 1e-15 of the middle between two
multiples: a chance of about 1e-10 an action. All multiples in the range of actions are also numbers of float32.
"""
LOW, HIGH = math.ceil(ACTION_LOW / STEP) * STEP, math.floor(ACTION_HIGH / STEP) * STEP
WIDEST = 1 << 16
"""Observations, actions or units of a layer."""
MAX_LAYERS = 256
"""Layers of a network."""

ACTIVATIONS = {
    "tanh": np.tanh,
    "relu": lambda x: np.maximum(x, 0.0),
    "elu": lambda x: np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0))),
    "sigmoid": lambda x: 1.0 / (1.0 + np.exp(-x)),
    "identity": lambda x: x,
}
"""Activation functions by rsl-rl's names."""


@dataclass(frozen=True, eq=False)
class Network:
    """Fully connected layers without exploration: observations to actions, in float64.

    ``action = center + scale * mlp((obs - mean) / deviation)``, rounded to multiples of :data:`STEP` within the range
    of actions.

    Attributes:
        weights: of each layer, float32 ``[outputs, inputs]``.
        biases: of each layer, float32 ``[outputs]``.
        mean, deviation: of the observations, float32 ``[num_obs]``.
        activation: between the layers, one of :data:`ACTIVATIONS`.
        scale, center: of the last layer's outputs.

    Raises:
        RunError: parts that do not fit together.
    """

    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]
    mean: np.ndarray
    deviation: np.ndarray
    activation: str
    scale: float
    center: float

    def __post_init__(self) -> None:
        check_choice("the activation of a stored policy", self.activation, ACTIVATIONS, RunError)
        arrays = (*self.weights, *self.biases, self.mean, self.deviation)
        shapes = [array.shape for array in arrays]
        sizes = [len(self.mean), *(len(bias) for bias in self.biases)] if self.biases and self.mean.ndim == 1 else []
        expected = [(after, before) for before, after in pairwise(sizes)]
        expected += [(size,) for size in [*sizes[1:], *sizes[:1], *sizes[:1]]]
        if not sizes or shapes != expected or not all(0 < size <= WIDEST for size in sizes):
            raise RunError(f"The layers of a policy do not fit together: {shapes!r:.200}.")
        finite = all(bool(np.isfinite(array).all()) for array in arrays) and math.isfinite(self.scale + self.center)
        if not finite or not bool((self.deviation > 0).all()):
            raise RunError("A policy has numbers that are not finite, or a deviation that is not positive.")

    @property
    def num_obs(self) -> int:
        """Size of an observation."""
        return len(self.mean)

    @property
    def num_actions(self) -> int:
        """Size of an action."""
        return len(self.biases[-1])

    def __call__(self, obs: Any) -> np.ndarray:
        """``obs`` ``[..., num_obs]``, array or torch tensor, to actions float64 ``[..., num_actions]``."""
        values = (as_observations(obs) - self.mean) / self.deviation
        last = len(self.weights) - 1
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            values = values @ weight.T.astype(np.float64) + bias
            values = values if layer == last else ACTIVATIONS[self.activation](values)
        return np.clip(np.round((self.center + self.scale * values) / STEP) * STEP, LOW, HIGH)


def as_observations(obs: Any) -> np.ndarray:
    """An array or a torch tensor as float64."""
    return np.asarray(obs.detach().cpu() if hasattr(obs, "detach") else obs, dtype=np.float64)
