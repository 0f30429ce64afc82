"""Files of robots, and their policies."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st

from warpvox import load_policy
from warpvox.algos.checkpoints.files import PolicySpec, build_actor, save_checkpoint, spec_dict
from warpvox.algos.checkpoints.policy import Policy, read_policy
from warpvox.algos.robots import Robot, judge, network_policy, read_robot, save_robot
from warpvox.algos.robots.policies import STEP
from warpvox.design import full_connections, load_design
from warpvox.errors import RunError

SIZES = (7, 5, 4, 3)


def random_network(activation: str = "tanh", seed: int = 0) -> Policy:
    rng = np.random.default_rng(seed)
    weights = tuple(rng.normal(size=(b, a)).astype(np.float32) for a, b in pairwise(SIZES))
    biases = tuple(rng.normal(size=b).astype(np.float32) for b in SIZES[1:])
    mean, deviation = rng.normal(size=7).astype(np.float32), rng.uniform(0.5, 2, 7).astype(np.float32)
    return network_policy(weights, biases, mean, deviation, activation)


def some_robot() -> Robot:
    body = load_design("mini")
    return Robot("Walker-v0", body, full_connections(body).T, random_network(), {"return": 1.5, "command": "warpvox"})


def test_a_file_gives_back_what_was_written(tmp_path: Path) -> None:
    robot = some_robot()
    again = read_robot(save_robot(tmp_path / "robot.npz", robot))
    assert (again.task, again.about, again.sha256) == (robot.task, robot.about, robot.sha256)
    obs = np.random.default_rng(1).normal(size=(9, 7))
    np.testing.assert_array_equal(again.policy(obs), robot.policy(obs))
    bare = read_robot(save_robot(tmp_path / "bare.npz", replace(robot, policy=None)))
    assert bare.policy is None
    np.testing.assert_array_equal(bare.connections, robot.connections)
    for play in (judge, load_policy):
        with pytest.raises(RunError, match="has no policy: there is a body alone"):
            play(bare)


def test_a_change_of_any_array_is_found(tmp_path: Path) -> None:
    path = save_robot(tmp_path / "robot.npz", some_robot())
    with np.load(path) as archive:
        arrays = dict(archive)
    for name in set(arrays) - {"header", "body"}:
        changed = arrays | {name: arrays[name] + arrays[name].dtype.type(1)}
        np.savez(path, **changed)
        with pytest.raises(RunError, match="checksum"):
            read_robot(path)


def say(arrays: dict[str, np.ndarray], **about: object) -> None:
    header = json.loads(arrays["header"].tobytes())
    header["about"] |= about
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda arrays: arrays.pop("header"), "no header"),
        (lambda arrays: arrays.pop("bias_1"), "bias_1"),
        (lambda arrays: arrays.update(body=arrays["body"] * 0), "empty"),
        (lambda arrays: arrays.update(weight_1=arrays["weight_0"]), "of another network"),
        (lambda arrays: arrays.update(deviation=arrays["deviation"] * 0), "above 0"),
        (lambda arrays: arrays.update(mean=arrays["mean"] * np.float32("nan")), "finite"),
        (lambda arrays: arrays.update(header=np.frombuffer(b'{"format": "x"}', np.uint8)), "not one of warpvox robot"),
        (lambda arrays: say(arrays, returns=1.0), "the returns in its header is 1.0, not a list"),
        (lambda arrays: say(arrays, lengths=500), "the lengths in its header is 500, not a list"),
        (lambda arrays: say(arrays, seeds=["a"]), "the seeds in its header is .'a'., not a list"),
        (lambda arrays: say(arrays, start=[1]), "the start in its header"),
        (lambda arrays: say(arrays, wall_s=10**400), "the wall_s in its header is 1000.*, not a number"),
        (lambda arrays: say(arrays, control_steps="1"), "the control_steps in its header is '1', not a number"),
        (lambda arrays: say(arrays, noise=0.9), "the noise in its header is 0.9, not a return and returns"),
        (lambda arrays: say(arrays, noise={"return": [1]}), r"the return in its header is \[1\], not a number"),
    ],
)
def test_a_file_that_is_no_robot_is_refused(damage, words: str, tmp_path: Path) -> None:
    path = save_robot(tmp_path / "robot.npz", some_robot())
    with np.load(path) as archive:
        arrays = dict(archive)
    damage(arrays)
    np.savez(path, **arrays)
    with pytest.raises(RunError, match=words):
        read_robot(path)


@given(st.integers(0, 10**6), st.sampled_from(["tanh", "relu", "elu", "sigmoid", "identity"]))
def test_actions_are_multiples_of_a_step_that_rounding_does_not_change(seed: int, activation: str) -> None:
    network = random_network(activation, seed)
    obs = np.random.default_rng(seed).normal(scale=3, size=(20, 7))
    actions = network(obs)
    assert ((actions >= 0.6) & (actions <= 1.6)).all()
    np.testing.assert_array_equal(actions, np.round(actions / STEP) * STEP)
    np.testing.assert_array_equal(actions, actions.astype(np.float32))
    # one at a time, as another size of the batch and other products round
    np.testing.assert_array_equal(actions, np.stack([network(row) for row in obs]))
    np.testing.assert_array_equal(actions, network(torch.from_numpy(obs)).numpy())


@pytest.mark.parametrize("activation", ["tanh", "relu", "elu", "sigmoid"])
def test_a_robot_acts_as_the_checkpoint_that_it_was_made_from(activation: str, tmp_path: Path) -> None:
    spec = PolicySpec(7, 3, [5, 4], activation, True, 0.5)
    torch.manual_seed(0)
    actor = build_actor(spec)
    actor.obs_normalizer._mean.copy_(torch.randn(1, 7))
    actor.obs_normalizer._std.copy_(torch.rand(1, 7) + 0.5)
    file = tmp_path / "model_best.pt"
    save_checkpoint(file, {"policy": spec_dict(spec), "actor_state_dict": actor.state_dict()})
    obs = 3 * torch.randn(50, 7, dtype=torch.float64)
    policy = read_policy(file)
    stored = replace(some_robot(), policy=policy).policy
    np.testing.assert_allclose(stored(obs), policy.in_float64()(obs), atol=STEP)


def test_an_activation_that_is_not_known_is_named() -> None:
    with pytest.raises(RunError, match="tahn"):
        random_network("tahn")
