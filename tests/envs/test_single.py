"""The fast way of a single environment: the same numbers as torch, bit for bit, in every task."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from warpvox.design import example_design
from warpvox.envs.adapters.gym import VoxelEnv
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.spec import TaskSpec, observes, rewards
from warpvox.envs.terms.rewards import action_rate, control_cost
from warpvox.envs.vec_env import VoxelVecEnv, make_vec


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
        for action in waves(env, 4):
            obs, reward, terminated, truncated, info = env.step(action)
            theirs, their_reward, their_end, _, their_info = slow.step(torch.as_tensor(action[None]))
            assert np.array_equal(obs, theirs[0].numpy())
            assert (obs.dtype, type(reward), type(terminated), truncated) == (np.float64, float, bool, False)
            assert (reward, terminated) == (float(their_reward), bool(their_end))
            for name, part in their_info["reward_terms"].items():
                assert info[f"reward_terms/{name}"] == part.item()
            assert (info["unstable"], info["diverged"]) == (bool(their_info["unstable"]), bool(their_info["diverged"]))
    ours, theirs = env.vec.state(), slow.state()
    assert all(torch.equal(ours[name], theirs[name]) for name in ("length", "return", "terminated", "truncated"))
    assert env.vec.memory.keys() == slow.memory.keys()
    assert all(torch.equal(value, slow.memory[name]) for name, value in env.vec.memory.items())


def test_it_goes_on_from_a_state_that_is_set() -> None:
    env = VoxelEnv("BidirectionalWalker-v0", body="walker")  # rewards compare with the state before, and with a memory
    env.reset()
    actions = waves(env, 6)
    for action in actions[:3]:
        env.step(action)
    kept = env.vec.state()
    expected = [env.step(action)[:3] for action in actions[3:]]
    env.vec.set_state(kept | {"sim": kept["sim"] | {"vel": kept["sim"]["vel"] + 1e6}})
    assert env.step(actions[3])[2], "it diverges"
    env.vec.set_state(kept)
    for action, (obs, *ends) in zip(actions[3:], expected, strict=True):
        found, *their_ends = env.step(action)[:3]
        assert np.array_equal(found, obs)
        assert their_ends == ends


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


def last_actions(state, name):
    return state.actions(name)


COSTS = (rewards(control_cost, weight=-1.0), rewards(action_rate, weight=-1.0))
SPEC = replace(get_task("Walker-v0"), id="Mine-v0", rewards=COSTS)
TASK = replace(SPEC, observations=(observes(last_actions),))
COUNTS = 8, 21  # actuators of mini and walker


def make_pair(spec: TaskSpec = TASK, **options) -> VoxelVecEnv:
    return make_vec(spec, ["mini", "walker"], 2, device="cpu", threads=1, **options)


def costs(info: dict) -> list[list[float]]:
    return [info["reward_terms"][f"{name}_robot"].tolist() for name in ("control_cost", "action_rate")]


def test_actions_are_clipped_and_those_of_padding_do_not_count() -> None:
    env = make_pair()
    obs, _ = env.reset()
    assert [row.eq(1).sum().item() for row in obs] == list(COUNTS), "an episode begins at rest"
    for value, told, change in (3.0, 0.6, 0.6), (0.0, -0.4, -1.0):
        obs, *_, info = env.step(torch.full((2, env.num_actions), value))
        assert all(row[:own].ne(1).all() and not row[own:].any() for row, own in zip(obs, COUNTS, strict=True))
        expected = [[-count * one**2 for count in COUNTS] for one in (told, change)]
        assert np.allclose(costs(info), expected, rtol=1e-6)
    env.reset()
    *_, info = env.step(torch.full((2, env.num_actions), 1.2))
    assert np.allclose(costs(info)[1], [-count * 0.2**2 for count in COUNTS], rtol=1e-5), "not of the last episode"


def test_another_body_has_its_own_actions() -> None:
    env = make_pair(grid=(5, 5))
    env.set_designs("mini", torch.tensor([False, True]))
    *_, info = env.step(torch.full((2, env.num_actions), 1.6))
    assert np.allclose(costs(info)[0], -8 * 0.6**2, rtol=1e-6)


def test_actions_before_a_resume_are_known_after_it() -> None:
    env, again = make_pair(), make_pair()
    first, second = torch.full((2, env.num_actions), 1.5), torch.full((2, env.num_actions), 0.7)
    env.step(first)
    again.set_state(env.state())
    for ours, theirs in zip(costs(env.step(second)[4]), costs(again.step(second)[4]), strict=True):
        assert ours == theirs


def test_an_episode_that_has_ended_keeps_its_actions() -> None:
    env = make_pair(auto_reset=False, max_episode_steps=2)
    env.reset()
    env.step(torch.full((2, env.num_actions), 1.5))
    env.reset(mask=torch.tensor([False, True]))
    last, *_ = env.step(torch.full((2, env.num_actions), 0.7))
    obs, _, _, truncated, _ = env.step(torch.full((2, env.num_actions), 0.9))
    assert truncated.all()
    assert torch.equal(obs[0], last[0])
    assert obs[1].ne(1).sum() == COUNTS[1]
    assert torch.equal(obs[1], torch.where(last[1] == 1, last[1], 0.9))


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_a_single_environment_is_stepped_fast_with_the_numbers_of_torch(dtype: str) -> None:
    env = VoxelEnv(SPEC, body="walker", dtype=dtype)
    slow = make_vec(SPEC, body="walker", device="cpu", dtype=dtype, threads=1, auto_reset=False)
    assert env._fast is not None
    env.reset()
    slow.reset()
    for action in np.random.default_rng(0).uniform(0, 2, (5, env.action_space.shape[0])):
        info, theirs = env.step(action)[4], slow.step(action[None])[4]
        for name, part in theirs["reward_terms"].items():
            assert info[f"reward_terms/{name}"] == part.item()
