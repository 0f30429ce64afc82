"""Open-loop policies of stored robots: what they compute, their files, their episodes."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st

from warpvox.algos.checkpoints.files import PolicySpec, save_checkpoint, spec_dict
from warpvox.algos.checkpoints.policy import parse_policy, policy_text
from warpvox.design import full_connections
from warpvox.envs.adapters.gym import VoxelEnv
from warpvox.errors import RunError
from warpvox.robots import Gait, Robot, judge, read_robot, robot_env, save_robot
from warpvox.robots.gait import ARRAYS
from warpvox.robots.replay import policy_of_checkpoint, torch_policy
from warpvox.view.rollout import record

BODY = np.array([[3, 4, 3], [3, 0, 4]])


def random_gait(seed: int = 0, stages: int = 3, actuators: int = 5) -> Gait:
    rng = np.random.default_rng(seed)
    begin = np.concatenate([[0], np.sort(rng.integers(0, 60, stages - 1))])
    each = {name: rng.normal(size=(stages, actuators)) for name in ("amplitude", "phase", "rest")}
    return Gait(begin, rng.uniform(4, 60, stages), **each)


def robot_of(gait: Gait, task: str = "Walker-v0") -> Robot:
    return Robot(task, BODY.astype(np.int8), full_connections(BODY).T, gait, {"return": 1.5})


def expected(gait: Gait, time: float) -> list[float]:
    """The actions at a time, number by number."""
    stage = max(k for k, begin in enumerate(gait.begin) if begin <= time)
    actions = []
    for amplitude, phase, rest in zip(gait.amplitude[stage], gait.phase[stage], gait.rest[stage], strict=True):
        part = math.fmod(time, gait.period[stage])
        wave = rest + amplitude * math.sin(2 * math.pi * part / gait.period[stage] + phase)
        actions.append(float(np.float32(1.1) + np.float32(0.5) * np.float32(min(max(wave, -1.0), 1.0))))
    return actions


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(1, 4))
def test_actions_are_sinusoids_of_the_time_alone(seed: int, stages: int) -> None:
    gait = random_gait(seed, stages)
    assert gait.num_parameters == stages * (2 + 3 * 5) - 1
    times = np.unique(np.concatenate([gait.begin, gait.begin + 1, np.arange(0, 100, 7)]))
    obs = np.random.default_rng(seed).normal(size=(len(times), 4))
    obs[:, -1] = times
    actions = gait(obs)
    np.testing.assert_allclose(actions, [expected(gait, time) for time in times], rtol=0, atol=2e-7)
    np.testing.assert_array_equal(actions, actions.astype(np.float32))
    np.testing.assert_array_equal(actions, gait(torch.from_numpy(obs)))
    np.testing.assert_array_equal(actions, np.stack([gait(row[-1:]) for row in obs]))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"begin": [1, 5, 9]}, "start with 0"),
        ({"begin": [0, 5, 4]}, "never decrease"),
        ({"begin": [0, 5]}, r"begin of a gait must have the shape \[3\]"),
        ({"period": [4.0, 0.0, 1.0]}, "period of a gait must be above 0"),
        ({"amplitude": np.zeros(5)}, r"amplitude .* \[stages, actuators\], got \[5\]"),
        ({"rest": np.full((3, 5), np.nan)}, "rest of a gait has numbers that are not finite"),
        ({"rest": [["a"]]}, "rest of a gait must be an array of numbers"),
    ],
)
def test_what_is_no_gait_is_refused(change: dict[str, Any], words: str) -> None:
    gait = random_gait()
    with pytest.raises(RunError, match=words):
        Gait(**{name: getattr(gait, name) for name in ARRAYS} | change)


def test_a_file_gives_back_what_was_written_and_a_change_is_found(tmp_path: Path) -> None:
    robot = robot_of(random_gait())
    path = save_robot(tmp_path / "robot.npz", robot)
    again = read_robot(path)
    assert (again.obs, again.about, again.sha256) == ("timed", robot.about, robot.sha256)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(again.policy, name), getattr(robot.policy, name))
    with np.load(path) as archive:
        arrays = dict(archive)
    for name in ARRAYS:
        np.savez(path, **arrays | {name: arrays[name] * 1.5 + (name != "begin")})
        with pytest.raises(RunError, match="checksum"):
            read_robot(path)
        np.savez(path, **{key: value for key, value in arrays.items() if key != name})
        with pytest.raises(RunError, match=name):
            read_robot(path)


def test_an_episode_is_that_of_its_formula() -> None:
    robot = robot_of(random_gait(), "Balancer-v0")
    found = judge(robot)
    env, rewards, terminated = VoxelEnv("Balancer-v0", BODY), [], False
    env.reset(seed=0)
    while not terminated and len(rewards) < 600:
        _, reward, terminated, _, _ = env.step(np.array(expected(robot.policy, len(rewards))))
        rewards.append(reward)
    assert (found.returns, found.lengths) == ([round(sum(rewards), 9)], [len(rewards)])
    rollout = record(robot_env(robot), robot.policy, 3)
    assert rollout.actions[:, 0].tolist() == [expected(robot.policy, step) for step in range(3)]


def test_a_gait_for_another_body_is_refused() -> None:
    robot = robot_of(random_gait(actuators=4))
    for use in (judge, robot_env):
        with pytest.raises(RunError, match="The gait has 4 actions, but this body has 5 actuators"):
            use(robot)


def checkpoint_of(gait: Gait, body: np.ndarray) -> dict[str, Any]:
    """A checkpoint with the values of a gait in the cells of a grid, as a design search leaves it."""
    actuators = torch.from_numpy(body >= 3)
    state = {name: torch.from_numpy(getattr(gait, name)) for name in ("begin", "period")}
    for name in ("amplitude", "phase", "rest"):
        state[name] = torch.full((gait.num_stages, *body.shape), 9.0, dtype=torch.float64)
        state[name][:, actuators] = torch.from_numpy(getattr(gait, name))
    spec = PolicySpec(9, gait.num_actions, [], "", False, 0.5, gait=dict(stages=3, rows=2, columns=3))
    return {"policy": spec_dict(spec), "actor_state_dict": state | {"cells": actuators.flatten().nonzero()[:, 0]}}


def test_as_a_torch_module_it_acts_the_same() -> None:
    gait = random_gait()
    policy = torch_policy(robot_of(gait))
    assert policy.metadata["obs"] == "timed"
    assert policy.num_obs == VoxelEnv("Walker-v0", BODY, obs="timed").observation_space.shape[0]
    obs = policy.network.random_obs(64, torch.Generator().manual_seed(0)).numpy()
    np.testing.assert_array_equal(policy.act(obs), gait(obs))  # as the search that found it
    again = parse_policy(policy_text(policy), "a file")  # what exports hold
    np.testing.assert_array_equal(again.act(obs), gait(obs))


def test_the_gait_of_a_checkpoint_has_the_values_of_its_actuators(tmp_path: Path) -> None:
    gait, file = random_gait(), tmp_path / "model_best.pt"
    content = checkpoint_of(gait, BODY)
    save_checkpoint(file, content)
    found = policy_of_checkpoint(file)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(found, name), getattr(gait, name))
    for name in (*ARRAYS, "cells"):
        state = {key: value for key, value in content["actor_state_dict"].items() if key != name}
        save_checkpoint(file, content | {"actor_state_dict": state})
        with pytest.raises(RunError, match="holds a policy of another kind"):
            policy_of_checkpoint(file)
