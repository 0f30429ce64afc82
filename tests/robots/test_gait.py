"""Open-loop policies of stored robots: what they compute, their files, their episodes."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st

from warpvox import load_policy
from warpvox.algos.checkpoints.files import PolicySpec, save_checkpoint, spec_dict
from warpvox.algos.checkpoints.policy import read_policy
from warpvox.algos.robots import Robot, gait_policy, judge, read_robot, robot_env, save_robot
from warpvox.algos.robots.policies import arrays_of
from warpvox.design import full_connections
from warpvox.envs.adapters.gym import VoxelEnv
from warpvox.errors import RunError
from warpvox.view.rollout import record

BODY = np.array([[3, 4, 3], [3, 0, 4]])


def random_arrays(seed: int = 0, stages: int = 3) -> dict[str, np.ndarray]:
    """The numbers of a gait of BODY, as a file keeps them."""
    rng = np.random.default_rng(seed)
    arrays = {"begin": np.concatenate([[0], np.sort(rng.integers(0, 60, stages - 1))])}
    arrays["period"] = rng.uniform(4, 60, stages)
    arrays |= {name: rng.normal(size=(stages, 5)) for name in ("amplitude", "phase", "rest")}
    return {name: values.astype(np.float32).astype(np.float64) for name, values in arrays.items()}


def robot_of(arrays: dict[str, np.ndarray], task: str = "Walker-v0") -> Robot:
    policy = gait_policy(BODY, **arrays)
    return Robot(task, BODY.astype(np.int8), full_connections(BODY).T, policy, {"return": 1.5})


def expected(gait: dict[str, np.ndarray], time: float) -> list[float]:
    """The actions at a time, number by number."""
    stage = max(k for k, begin in enumerate(gait["begin"]) if begin <= time)
    period = gait["period"][stage]
    actions = []
    for amplitude, phase, rest in zip(*(gait[name][stage] for name in ("amplitude", "phase", "rest")), strict=True):
        wave = rest + amplitude * math.sin(2 * math.pi * math.fmod(time, period) / period + phase)
        actions.append(float(np.float32(1.1) + np.float32(0.5) * np.float32(min(max(wave, -1.0), 1.0))))
    return actions


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(1, 4))
def test_actions_are_sinusoids_of_the_time_alone(seed: int, stages: int) -> None:
    arrays = random_arrays(seed, stages)
    gait = gait_policy(BODY, **arrays)
    times = np.unique(np.concatenate([arrays["begin"], arrays["begin"] + 1, np.arange(0, 100, 7)]))
    obs = np.random.default_rng(seed).normal(size=(len(times), 4))
    obs[:, -1] = times
    actions = gait(obs)
    np.testing.assert_allclose(actions, [expected(arrays, time) for time in times], rtol=0, atol=2e-7)
    np.testing.assert_array_equal(actions, actions.astype(np.float32))
    np.testing.assert_array_equal(actions, gait(torch.from_numpy(obs)).numpy())
    np.testing.assert_array_equal(actions, np.stack([gait(row[-1:]) for row in obs]))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"begin": [1, 5, 9]}, "start with 0"),
        ({"begin": [0, 5, 4]}, "never decrease"),
        ({"begin": [0, 5]}, r"period of a gait must have the shape \[2\]"),
        ({"period": [4.0, 0.0, 1.0]}, "must be above 0"),
        ({"amplitude": np.zeros(5)}, r"amplitude .* \[3, 5\], got \[5\]"),
        ({"rest": np.zeros((3, 4))}, r"rest .* \[3, 5\], got \[3, 4\]"),
        ({"rest": np.full((3, 5), np.nan)}, "finite"),
        ({"rest": [["a"]]}, "could not convert"),
    ],
)
def test_what_is_no_gait_is_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(RunError, match=words):
        gait_policy(BODY, **random_arrays() | change)


def test_a_file_gives_back_what_was_written_and_a_change_is_found(tmp_path: Path) -> None:
    known = random_arrays()
    robot = robot_of(known)
    path = save_robot(tmp_path / "robot.npz", robot)
    again = read_robot(path)
    assert (again.obs, again.about, again.sha256) == ("timed", robot.about, robot.sha256)
    for name, values in arrays_of(again.policy).items():
        np.testing.assert_array_equal(values, known[name])
    with np.load(path) as archive:
        arrays = dict(archive)
    for name in known:
        np.savez(path, **arrays | {name: arrays[name] * 1.5 + (name != "begin")})
        with pytest.raises(RunError, match="checksum"):
            read_robot(path)
        np.savez(path, **{key: value for key, value in arrays.items() if key != name})
        with pytest.raises(RunError, match=name):
            read_robot(path)


def test_an_episode_is_that_of_its_formula() -> None:
    arrays = random_arrays()
    robot = robot_of(arrays, "Balancer-v0")
    found = judge(robot)
    env, rewards, terminated = VoxelEnv("Balancer-v0", BODY), [], False
    env.reset(seed=0)
    while not terminated and len(rewards) < 600:
        _, reward, terminated, _, _ = env.step(np.array(expected(arrays, len(rewards))))
        rewards.append(reward)
    assert (found.returns, found.lengths) == ([round(sum(rewards), 9)], [len(rewards)])
    rollout = record(robot_env(robot), robot.policy, 3)
    assert rollout.actions[:, 0].tolist() == [expected(arrays, step) for step in range(3)]


def test_a_gait_for_another_body_is_refused() -> None:
    other = np.array([[3, 4, 3], [3, 4, 4]], np.int8)
    with pytest.raises(RunError, match="none of this body"):
        Robot("Walker-v0", other, full_connections(other).T, gait_policy(BODY, **random_arrays()))


def checkpoint_of(gait: dict[str, np.ndarray], body: np.ndarray) -> dict[str, Any]:
    """A checkpoint with the values of a gait in the cells of a grid, as a design search leaves it."""
    actuators = torch.from_numpy(body >= 3)
    state = {name: torch.from_numpy(gait[name]) for name in ("begin", "period")}
    for name in ("amplitude", "phase", "rest"):
        state[name] = torch.full((len(gait["begin"]), *body.shape), 9.0, dtype=torch.float64)
        state[name][:, actuators] = torch.from_numpy(gait[name])
    spec = PolicySpec(9, 5, [], "", False, 0.5, gait=dict(stages=3, rows=2, columns=3))
    return {"policy": spec_dict(spec), "actor_state_dict": state | {"cells": actuators.flatten().nonzero()[:, 0]}}


def test_what_load_policy_gives_acts_the_same() -> None:
    robot = robot_of(random_arrays())
    policy = load_policy(robot)
    assert policy.metadata["obs"] == "timed"
    assert policy.num_obs == VoxelEnv("Walker-v0", BODY, obs="timed").observation_space.shape[0]
    obs = policy.network.random_obs(64, torch.Generator().manual_seed(0)).numpy()
    np.testing.assert_array_equal(policy.act(obs), robot.policy(obs))  # as the search that found it


def test_the_gait_of_a_checkpoint_has_the_values_of_its_actuators(tmp_path: Path) -> None:
    arrays = random_arrays()
    file = tmp_path / "model_best.pt"
    content = checkpoint_of(arrays, BODY)
    save_checkpoint(file, content)
    found = read_policy(file)
    for name, values in arrays_of(found).items():
        np.testing.assert_array_equal(values, arrays[name])
    for name in content["actor_state_dict"]:
        state = {key: value for key, value in content["actor_state_dict"].items() if key != name}
        save_checkpoint(file, content | {"actor_state_dict": state})
        with pytest.raises(RunError, match="holds a policy of another kind"):
            read_policy(file)
