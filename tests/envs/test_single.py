"""The fast way of a single environment: the same numbers as torch, bit for bit, in every task."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from warpvox.design import example_design
from warpvox.envs.adapters.gym import VoxelEnv
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.spec import rewards
from warpvox.envs.vec_env import make_vec
from warpvox.errors import ActionError


def waves(env: VoxelEnv, steps: int) -> np.ndarray:
    return np.random.default_rng(1).uniform(0.6, 1.6, (steps, *env.action_space.shape))


@pytest.mark.parametrize("rules", ["evogym", "paper"])
@pytest.mark.parametrize("task", task_ids())
def test_every_task_is_stepped_fast_with_the_numbers_of_torch(task: str, rules: str) -> None:
    env = VoxelEnv(task, body=example_design("walker"), rules=rules)
    slow = make_vec(task, body="walker", device="cpu", dtype="float64", rules=rules, threads=1, auto_reset=False)
    assert env._fast is not None
    for seed in (3, None):
        assert np.array_equal(env.reset(seed=seed)[0], slow.reset(seed=seed)[0][0].numpy())
        for action in waves(env, 8):
            obs, reward, terminated, truncated, info = env.step(action)
            theirs, their_reward, their_end, _, their_info = slow.step(torch.as_tensor(action[None]))
            assert np.array_equal(obs, theirs[0].numpy())
            assert (obs.dtype, type(reward), type(terminated), truncated) == (np.float64, float, bool, False)
            assert (reward, terminated) == (float(their_reward), bool(their_end))
            assert info["reward_terms"] == {name: part.item() for name, part in their_info["reward_terms"].items()}
            assert (info["unstable"], info["diverged"]) == (bool(their_info["unstable"]), bool(their_info["diverged"]))
    ours, theirs = env.vec.state(), slow.state()
    assert all(torch.equal(ours[name], theirs[name]) for name in ("length", "return", "terminated", "truncated"))
    assert env.vec.memory.keys() == slow.memory.keys()
    assert all(torch.equal(value, slow.memory[name]) for name, value in env.vec.memory.items())


class _Count(TorchDispatchMode):
    """Counts operations of torch."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        self.count += 1
        return function(*args, **(kwargs or {}))


@pytest.mark.parametrize("task", ["Walker-v0", "Carrier-v1", "UpStepper-v0", "AreaMaximizer-v0"])
def test_a_step_starts_no_operation_of_torch(task: str) -> None:
    env = VoxelEnv(task, body="walker")
    env.reset()
    with _Count() as operations:
        env.step(np.ones(env.action_space.shape))
    assert operations.count == 0


def doubled(before, after, name):  # a term of a user's own, which may do anything that torch can
    return torch.as_tensor(2.0 * (after.com(name) - before.com(name))[:, 0])


def test_terms_of_others_are_left_to_torch() -> None:
    task = replace(get_task("Walker-v0"), id="Own-v0", rewards=(rewards(doubled),))
    env, plain = VoxelEnv(task, body="walker"), VoxelEnv("Walker-v0", body="walker")
    assert env._fast is None
    assert VoxelEnv("Walker-v0", body="walker", obs="voxel")._fast is None
    env.reset(), plain.reset()
    for action in waves(env, 4):
        (obs, reward, *_), (theirs, their_reward, *_) = env.step(action), plain.step(action)
        assert np.array_equal(obs, theirs)
        assert reward == 2 * their_reward


@pytest.mark.filterwarnings("error")
def test_actions_are_checked_and_clipped_as_before() -> None:
    env, twin = VoxelEnv("Walker-v0", body="walker"), VoxelEnv("Walker-v0", body="walker")
    env.reset(), twin.reset()
    huge, most = np.full(env.action_space.shape, 1e308), np.full(env.action_space.shape, 1.6)
    with pytest.raises(ActionError, match="finite"):
        env.step(np.where(np.arange(huge.size) == 2, np.nan, 1.0))
    for _ in range(3):
        (obs, reward, *_), (theirs, their_reward, *_) = env.step(huge), twin.step(most)
        assert np.array_equal(obs, theirs)
        assert reward == their_reward
