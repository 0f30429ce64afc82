"""Stored robots in batches of environments and as torch modules, and policies as those of stored robots."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch

from warpvox.algos.checkpoints.files import PolicySpec, load_controller
from warpvox.algos.checkpoints.policy import Layers, Policy, make_policy, policy_of
from warpvox.algos.policies.gait import AMPLITUDE
from warpvox.design import Design
from warpvox.envs.registry import task_ids
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.errors import ConfigError, RunError
from warpvox.robots.entry import Robot
from warpvox.robots.gait import Gait
from warpvox.robots.network import STEP, Network
from warpvox.types import ACTION_CENTER, Cell

BY_CELL = ("amplitude", "phase", "rest")
"""Fields that a gait has for each actuator, and a checkpoint of it for each cell of a grid."""
SEEDS = tuple(range(1000, 1008))
"""Seeds of the episodes of a task that draws something at random; other tasks have one episode."""


def robot_env(robot: Robot, seeds: Sequence[int] = (0,), **options: Any) -> VoxelVecEnv:
    """Environments with the body of ``robot``, one a seed; exact and on the CPU unless ``options`` say otherwise.

    They give the observations that its policy takes (:attr:`Robot.obs`).

    Raises:
        TaskError, DesignError, WorldError: as :func:`warpvox.make_vec`. RunError: another number of observations or
            actions than the policy has.
    """
    defaults = {"device": "cpu", "dtype": "float64", "auto_reset": False, "seed": list(seeds), "num_envs": len(seeds)}
    connections = None if robot.fully_connected else robot.connections
    env = make_vec(robot.task, body=robot.body, connections=connections, obs=robot.obs, **(defaults | options))
    check_sizes(robot, env.num_obs, env.num_actions)
    return env


def check_sizes(robot: Robot, num_obs: int, num_actions: int) -> None:
    """Raise RunError unless the policy is for so many observations and actions."""
    policy = robot.policy
    if isinstance(policy, Gait):
        if policy.num_actions != num_actions:
            raise RunError(f"The gait has {policy.num_actions} actions, but this body has {num_actions} actuators.")
    elif policy is not None and (policy.num_obs, policy.num_actions) != (num_obs, num_actions):
        raise RunError(
            f"The policy has {policy.num_obs} observations and {policy.num_actions} actions, but {robot.task} with this"
            f" body has {num_obs} and {num_actions}."
        )


def policy_of_checkpoint(checkpoint: Path) -> Network | Gait:
    """The policy of a checkpoint file, as a stored robot has it."""
    policy = policy_of(load_controller(checkpoint))
    if policy.spec.gait is not None:
        state = {name: value.numpy() for name, value in cast(Any, policy.network.model).state_dict().items()}
        by_cell = {name: state[name].reshape(len(state["begin"]), -1)[:, state["cells"]] for name in BY_CELL}
        return Gait(state["begin"], state["period"], **by_cell)
    if policy.spec.voxels is not None or policy.spec.rnn is not None:
        kind = "recurrent policy" if policy.spec.rnn else "policy for voxels"
        raise RunError(f"{checkpoint} holds a {kind}; the zoo has gaits and policies of fully connected layers (mlp).")
    network = cast(Layers, policy.network)
    state = {name: value.numpy() for name, value in network.state_dict().items()}
    layers = sorted((name for name in state if name.endswith(".weight")), key=lambda name: int(name.split(".")[1]))
    weights = tuple(state[name] for name in layers)
    biases = tuple(state[name.removesuffix("weight") + "bias"] for name in layers)
    spec, deviation = policy.spec, (network.deviation + network.eps).numpy()
    return Network(weights, biases, state["mean"], deviation, spec.activation, float(spec.action_scale), ACTION_CENTER)


def known_task(robot: Robot) -> str:
    """The id of the robot's task; ConfigError: it is a task of the user's own, whose code has to be named."""
    if robot.task not in task_ids():
        raise ConfigError(f"The robot is for {robot.task}, a task of your own: name its code, task=FILE.py:NAME.")
    return robot.task


def torch_policy(robot: Robot, device: str = "cpu") -> Policy:
    """The policy of ``robot`` as a torch module.

    In float32 its actions are not rounded; in float64 they are those of the robot. Its ``metadata`` say how the robot
    is evaluated: exactly, with a seed for each episode (``seed_each``).
    """
    network = robot.own_policy
    about: dict[str, Any] = {"task": robot.task, "rules": "evogym", "obs": robot.obs, "design": robot.body.tolist()}
    about |= {"dtype": "float64", "seed_each": True}
    if not robot.fully_connected:
        about["connections"] = robot.connections.tolist()
    if isinstance(network, Gait):
        return _gait_module(robot, network, about).to(device)
    hidden = [len(bias) for bias in network.biases[:-1]]
    spec = PolicySpec(network.num_obs, network.num_actions, hidden, network.activation, False, network.scale)
    policy = make_policy(spec, about | {"action_step": STEP})
    state = {"mean": network.mean, "deviation": network.deviation}
    for layer, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        last = layer == len(network.weights) - 1
        # Policy's centre is fixed: another one goes into the last bias
        moved = bias + (network.center - ACTION_CENTER) / network.scale if last else bias
        state |= {f"mlp.{2 * layer}.weight": weight, f"mlp.{2 * layer}.bias": moved}
    policy.network.load_state_dict({name: torch.as_tensor(value, dtype=torch.float32) for name, value in state.items()})
    return policy.to(device)


def by_cell(gait: Gait, body: Design) -> dict[str, np.ndarray]:
    """Amplitude, phase and rest by cell, float64 ``[stages, rows, columns]``; 0 where there is no actuator."""
    grids = {name: np.zeros((gait.num_stages, *body.shape)) for name in BY_CELL}
    for name, grid in grids.items():
        grid[:, body >= Cell.H_ACT] = getattr(gait, name)
    return grids


def _gait_module(robot: Robot, gait: Gait, about: dict[str, Any]) -> Policy:
    sizes = {"stages": gait.num_stages, "rows": robot.body.shape[0], "columns": robot.body.shape[1]}
    num_obs = robot_env(robot).num_obs
    policy = make_policy(PolicySpec(num_obs, gait.num_actions, [], "", False, AMPLITUDE, gait=sizes), about)
    cells = np.flatnonzero(robot.body >= Cell.H_ACT)
    state = {"begin": gait.begin, "period": gait.period, "cells": cells}
    state |= by_cell(gait, robot.body)
    cast(Any, policy.network.model).load_state_dict({name: torch.as_tensor(values) for name, values in state.items()})
    return policy
