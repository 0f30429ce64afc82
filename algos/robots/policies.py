"""Policies of stored robots, whose actions are equal on every machine."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from warpvox.algos.checkpoints.files import PolicySpec, check_spec
from warpvox.algos.checkpoints.policy import Policy
from warpvox.design import Design
from warpvox.errors import RunError, first_line
from warpvox.types import ACTION_CENTER, ACTION_SCALE, Cell

STEP = 2.0**-16
"""Quantisation step of the actions of stored networks.

How a matrix product or a tanh is rounded depends on the CPU and the libraries. Such differences are about 1e-15 and are
gone after rounding to a step that is 1e10 times as large, unless an action lies within 1e-15 of the middle between two
multiples: a chance of about 1e-10 an action. All multiples in the range of actions are also numbers of float32.
"""
MOTION = ("amplitude", "phase", "rest")
"""Arrays of a gait with a value per actuator; ``begin`` and ``period`` have one per stage."""


def network_policy(
    weights: Sequence[np.ndarray],
    biases: Sequence[np.ndarray],
    mean: np.ndarray,
    deviation: np.ndarray,
    activation: str,
    scale: float = ACTION_SCALE,
    center: float = ACTION_CENTER,
) -> Policy:
    """Create a policy ``center + scale * mlp((obs - mean) / deviation)``, rounded to multiples of :data:`STEP`.

    Args:
        weights, biases: of each layer, ``[outputs, inputs]`` and ``[outputs]``, kept as float32.
        mean, deviation: of the observations, ``[num_obs]``, kept as float32.
        activation: between the layers, by rsl-rl's name.
        scale, center: of the last layer's outputs.

    Raises:
        RunError: parts that do not fit together, or numbers that are not finite.
    """
    try:
        sizes = [len(mean), *(len(bias) for bias in biases)]
        spec = PolicySpec(
            num_obs=sizes[0],
            num_actions=sizes[-1],
            hidden=sizes[1:-1],
            activation=activation,
            normalize_obs=True,
            action_scale=float(scale),
            action_center=float(center),
            action_step=STEP,
            obs_eps=0.0,
        )
        deviation = np.asarray(deviation, np.float32)
        if not bool((deviation > 0).all()):
            raise ValueError("the deviation must be above 0")
        state = {
            "obs_normalizer._mean": np.asarray(mean, np.float32)[None],
            "obs_normalizer._var": deviation[None] ** 2,
            "obs_normalizer._std": deviation[None],
            "obs_normalizer.count": np.array(0),
        }
        for layer, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
            state[f"mlp.{2 * layer}.weight"] = np.asarray(weight, np.float32)
            state[f"mlp.{2 * layer}.bias"] = np.asarray(bias, np.float32)
        return _float64_policy(spec, state)
    except (TypeError, ValueError, RuntimeError, LookupError) as error:
        raise RunError(f"The network of a policy cannot be made: {first_line(error):.200}") from None


def gait_policy(
    body: Design, begin: np.ndarray, period: np.ndarray, amplitude: np.ndarray, phase: np.ndarray, rest: np.ndarray
) -> Policy:
    """Create an open-loop policy for ``obs="timed"``: sinusoids of the time, in one stage or several.

    ``action = 1.1 + 0.5 * clip(rest + amplitude * sin(2 pi t / period + phase), -1, 1)`` with the values of the last
    stage that begins at ``t`` or before. ``t`` is the control steps since the episode began, the last number of the
    observation; nothing else of it is read. What is cut is rounded to float32, and so is the action, as in the search
    that finds a gait: on all machines, but for the sines (one in 1e9) that lie just between two numbers of float32.

    Args:
        body: that it moves.
        begin: control step at which each stage begins, ``[stages]``: 0 first, never decreasing.
        period: of the oscillation in each stage in control steps, ``[stages]``.
        amplitude, phase, rest: of each actuator, ``[stages, num_actions]``; phases in radians. All numbers are kept as
            those of float32.

    Raises:
        RunError: arrays that do not fit together or to the body, or values out of range.
    """
    given = {"begin": begin, "period": period, "amplitude": amplitude, "phase": phase, "rest": rest}
    try:
        with np.errstate(over="ignore"):
            arrays = {name: np.asarray(value, np.float64).astype(np.float32) for name, value in given.items()}
        cells = np.flatnonzero(body >= Cell.H_ACT)
        stages = arrays["begin"].shape[0]
        for name, value in arrays.items():
            shape = (stages, len(cells)) if name in MOTION else (stages,)
            if value.shape != shape:
                raise ValueError(f"{name} of a gait must have the shape {list(shape)}, got {list(value.shape)}")

        # By cell; 0 where there is no actuator
        state: dict[str, Any] = {"cells": cells}
        for name, value in arrays.items():
            if name in MOTION:
                grid = np.zeros((stages, body.size))
                grid[:, cells] = value
                value = grid.reshape(stages, *body.shape)
            state[name] = value.astype(np.float64)

        spec = PolicySpec(
            num_obs=1,
            num_actions=len(cells),
            hidden=[],
            activation="",
            normalize_obs=False,
            action_scale=ACTION_SCALE,
            gait={"stages": stages, "rows": body.shape[0], "columns": body.shape[1]},
        )
        return _float64_policy(spec, state)
    except (TypeError, ValueError, LookupError) as error:
        raise RunError(f"The gait is none of this body: {first_line(error):.200}") from None


def _float64_policy(spec: PolicySpec, state: dict[str, np.ndarray]) -> Policy:
    """Validate ``state`` against ``spec``, and return the policy in float64."""
    tensors = {name: torch.as_tensor(value) for name, value in state.items()}
    check_spec(spec, tensors)
    return Policy(spec, tensors).double()


def as_stored(policy: Policy, body: Design) -> Policy:
    """Convert a policy for ``body`` to the form of robot files, in float64.

    Raises:
        RunError: it is recurrent or one for voxels, or it is for another body.
    """
    if policy.spec.voxels is not None or policy.spec.rnn is not None:
        kind = "recurrent policies" if policy.spec.rnn else "policies for voxels"
        raise RunError(f"Robots are stored with gaits and policies of fully connected layers (mlp), not with {kind}.")
    arrays = arrays_of(policy)
    if policy.spec.gait is not None:
        return gait_policy(body, **arrays)
    layers = range(len(policy.spec.hidden) + 1)
    return network_policy(
        [arrays[f"weight_{layer}"] for layer in layers],
        [arrays[f"bias_{layer}"] for layer in layers],
        arrays["mean"],
        arrays["deviation"],
        policy.spec.activation,
        policy.spec.action_scale,
        policy.spec.action_center,
    )


def arrays_of(policy: Policy) -> dict[str, np.ndarray]:
    """Return a policy's arrays: arguments of :func:`gait_policy` (float64) or :func:`network_policy` (float32)."""
    state = {name: value.detach().cpu().numpy() for name, value in policy.actor.state_dict().items()}
    if policy.spec.gait is not None:
        arrays = {"begin": state["begin"], "period": state["period"]}
        for name in MOTION:
            arrays[name] = state[name].reshape(len(state["begin"]), -1)[:, state["cells"]]
        return arrays

    # An untrained normaliser neither moves nor scales.
    mean = state.get("obs_normalizer._mean", np.zeros(policy.num_obs))
    deviation = state.get("obs_normalizer._std", np.ones(policy.num_obs))
    eps = policy.spec.obs_eps if policy.spec.normalize_obs else 0.0
    arrays = {
        "mean": mean.reshape(-1).astype(np.float32),
        "deviation": deviation.reshape(-1).astype(np.float32) + np.float32(eps),
    }
    for layer in range(len(policy.spec.hidden) + 1):
        for kind in ("weight", "bias"):
            arrays[f"{kind}_{layer}"] = state[f"mlp.{2 * layer}.{kind}"].astype(np.float32)
    return arrays
