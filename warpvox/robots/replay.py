"""Replay of stored robots: episodes in exact arithmetic, which any machine repeats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch

from warpvox.algos.checkpoints.files import PolicySpec, load_controller
from warpvox.algos.checkpoints.policy import Policy, make_policy, policy_of
from warpvox.algos.disturbance import Disturbed
from warpvox.algos.evaluate import evaluate
from warpvox.algos.policies.gait import AMPLITUDE
from warpvox.algos.protocols import ROBUST, parts_of
from warpvox.design import Design
from warpvox.envs.adapters.gym import VoxelEnv
from warpvox.envs.adapters.rsl_rl import ACTION_CENTER
from warpvox.envs.registry import get_task
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.errors import RunError
from warpvox.robots.entry import DIGITS, Robot
from warpvox.robots.gait import Gait
from warpvox.robots.network import Network
from warpvox.types import Cell

__all__ = [
    "SEEDS",
    "Judgement",
    "by_cell",
    "judge",
    "judge_robust",
    "policy_of_checkpoint",
    "recorded",
    "robot_env",
    "torch_policy",
]

EPISODES = 32
"""Disturbed episodes of a robot."""
BY_CELL = ("amplitude", "phase", "rest")
"""Fields that a gait has for each actuator, and a checkpoint of it for each cell of a grid."""
SEEDS = tuple(range(1000, 1008))
"""Seeds of the episodes of a task that draws something at random; other tasks have one episode."""


@dataclass(frozen=True)
class Judgement:
    """Episodes of a robot: ``returns`` (rounded to nine decimals) and ``lengths`` (control steps) by ``seeds``."""

    returns: list[float]
    lengths: list[int]
    seeds: list[int]

    @property
    def mean_return(self) -> float:
        """Over the episodes, rounded in the same way."""
        return round(sum(self.returns) / len(self.returns), DIGITS)


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
    _check_sizes(robot, env.num_obs, env.num_actions)
    return env


def _check_sizes(robot: Robot, num_obs: int, num_actions: int) -> None:
    policy = robot.policy
    if isinstance(policy, Gait):
        if policy.num_actions != num_actions:
            raise RunError(f"The gait has {policy.num_actions} actions, but this body has {num_actions} actuators.")
    elif policy is not None and (policy.num_obs, policy.num_actions) != (num_obs, num_actions):
        raise RunError(
            f"The policy has {policy.num_obs} observations and {policy.num_actions} actions, but {robot.task} with this"
            f" body has {num_obs} and {num_actions}."
        )


def judge(robot: Robot, seeds: Sequence[int] | None = None) -> Judgement:
    """Run the episodes of ``robot`` in exact arithmetic: those are the returns that EvoGym itself gives.

    Args:
        seeds: one an episode; None: :data:`SEEDS` where the task draws something, else a single episode.

    Raises:
        RunError: it has no policy, or one for other environments.
    """
    if robot.policy is None:
        why = robot.about.get("no_policy", "there is a body alone, for which one can be trained.")
        raise RunError(f"The robot has no policy that could be evaluated: {why}")
    seeds = list(seeds if seeds is not None else SEEDS if get_task(robot.task).is_random else (0,))
    # one at a time, as numpy steps a single environment faster than torch
    env = VoxelEnv(robot.task, robot.body, None if robot.fully_connected else robot.connections, obs=robot.obs)
    _check_sizes(robot, *cast(Any, env.observation_space.shape), *cast(Any, env.action_space.shape))
    returns, lengths = zip(*(_episode(env, robot, seed) for seed in seeds), strict=True)
    return Judgement(list(returns), list(lengths), seeds)


def judge_robust(robot: Robot, protocol: str = ROBUST, episodes: int = EPISODES) -> dict[str, list[float]]:
    """Returns of ``robot`` in disturbed episodes in exact arithmetic: ``episodes`` of each disturbance.

    Those of :data:`warpvox.algos.protocols.PROTOCOLS`, side by side; :func:`judge` gives the nominal ones.

    Raises:
        RunError: a policy for other environments. ConfigError: no disturbance of ``protocol`` concerns its policy.
    """
    parts = parts_of(protocol, feedback=not isinstance(robot.policy, Gait))
    env = robot_env(robot, [SEEDS[0] + number for number in range(episodes)] * len(parts))
    found = evaluate(env, Disturbed(cast(Any, robot.policy), env, parts, SEEDS[0])).returns
    return {
        part: [round(value, DIGITS) for value in row.tolist()]
        for part, row in zip(parts, found.view(len(parts), -1), strict=True)
    }


def _episode(env: VoxelEnv, robot: Robot, seed: int) -> tuple[float, int]:
    """Return and control steps."""
    obs, _ = env.reset(seed=seed)
    rewards: list[float] = []
    terminated, limit = False, get_task(robot.task).max_episode_steps
    while not terminated and len(rewards) < limit:
        obs, reward, terminated, _, _ = env.step(cast(Any, robot.policy)(obs))
        rewards.append(reward)
    return round(sum(rewards), DIGITS), len(rewards)


def recorded(robot: Robot, about: dict[str, Any]) -> Robot:
    """``robot`` with its returns, nominal and under noise, and ``about`` as an entry of the zoo states them."""
    result = judge(robot)
    found = {"return": result.mean_return, "returns": result.returns, "lengths": result.lengths, "seeds": result.seeds}
    noisy = judge_robust(robot, "noise")["noise"]
    found["noise"] = {"return": round(sum(noisy) / len(noisy), DIGITS), "returns": noisy}
    date = datetime.now(timezone.utc).strftime("%Y-%m-%d")
    return replace(robot, about=found | about | {"date": date})


def policy_of_checkpoint(checkpoint: Path) -> Network | Gait:
    """The policy of a checkpoint file, as a stored robot has it.

    Raises:
        RunError: no such file, or a policy that is neither a gait nor one of fully connected layers.
    """
    policy = policy_of(load_controller(checkpoint))
    if policy.spec.gait is not None:
        state = {name: value.numpy() for name, value in cast(Any, policy.model).state_dict().items()}
        by_cell = {name: state[name].reshape(len(state["begin"]), -1)[:, state["cells"]] for name in BY_CELL}
        return Gait(state["begin"], state["period"], **by_cell)
    if policy.spec.voxels is not None or policy.spec.rnn is not None:
        kind = "recurrent policy" if policy.spec.rnn else "policy for voxels"
        raise RunError(f"{checkpoint} holds a {kind}; the zoo has gaits and policies of fully connected layers (mlp).")
    state = {name: value.numpy() for name, value in policy.state_dict().items()}
    layers = sorted((name for name in state if name.endswith(".weight")), key=lambda name: int(name.split(".")[1]))
    weights = tuple(state[name] for name in layers)
    biases = tuple(state[name.removesuffix("weight") + "bias"] for name in layers)
    spec = policy.spec
    return Network(
        weights, biases, state["mean"], state["deviation"], spec.activation, float(spec.action_scale), ACTION_CENTER
    )


def torch_policy(robot: Robot, device: str = "cpu") -> Policy:
    """The policy of ``robot`` as a torch module, float32 and without the rounding of its actions.

    Raises:
        RunError: it has none.
    """
    network = robot.policy
    about = {"task": robot.task, "rules": "evogym", "obs": robot.obs, "design": robot.body.tolist()}
    if network is None:
        raise RunError(f"The robot has no policy: {robot.about.get('no_policy', 'there is a body alone.')}")
    if isinstance(network, Gait):
        return _gait_module(robot, network, about).to(device)
    hidden = [len(bias) for bias in network.biases[:-1]]
    spec = PolicySpec(network.num_obs, network.num_actions, hidden, network.activation, True, network.scale)
    policy = make_policy(spec, about)
    state = {"mean": network.mean, "deviation": network.deviation}
    for layer, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        last = layer == len(network.weights) - 1
        # Policy's centre is fixed: another one goes into the last bias
        moved = bias + (network.center - ACTION_CENTER) / network.scale if last else bias
        state |= {f"mlp.{2 * layer}.weight": weight, f"mlp.{2 * layer}.bias": moved}
    policy.load_state_dict({name: torch.as_tensor(value, dtype=torch.float32) for name, value in state.items()})
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
    cast(Any, policy.model).load_state_dict({name: torch.as_tensor(values) for name, values in state.items()})
    return policy
