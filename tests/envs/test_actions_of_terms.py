"""Terms see actions: as they are applied, without those that a body does not have, also after a resume."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from warpvox.envs.adapters.gym import VoxelEnv
from warpvox.envs.registry import get_task
from warpvox.envs.spec import TaskSpec, observes, rewards
from warpvox.envs.terms.rewards import action_rate, control_cost
from warpvox.envs.vec_env import VoxelVecEnv, make_vec


def last_actions(state, name):
    return state.actions(name)


COSTS = (rewards(control_cost, weight=-1.0), rewards(action_rate, weight=-1.0))
SPEC = replace(get_task("Walker-v0"), id="Mine-v0", rewards=COSTS)
TASK = replace(SPEC, observations=(observes(last_actions),))
COUNTS = 8, 21  # actuators of mini and walker


def make(spec: TaskSpec = TASK, **options) -> VoxelVecEnv:
    return make_vec(spec, ["mini", "walker"], 2, device="cpu", threads=1, **options)


def costs(info: dict) -> list[list[float]]:
    return [info["reward_terms"][f"{name}_robot"].tolist() for name in ("control_cost", "action_rate")]


def test_actions_are_clipped_and_have_no_padding() -> None:
    env = make()
    obs, _ = env.reset()
    assert obs.eq(1).all(), "an episode begins at rest"
    for value, told, change in (3.0, 0.6, 0.6), (0.0, -0.4, -1.0):
        obs, *_, info = env.step(torch.full((2, env.num_actions), value))
        assert [row.ne(1).sum().item() for row in obs] == list(COUNTS)
        expected = [[-count * one**2 for count in COUNTS] for one in (told, change)]
        assert np.allclose(costs(info), expected, rtol=1e-6)
    env.reset()
    *_, info = env.step(torch.full((2, env.num_actions), 1.2))
    assert np.allclose(costs(info)[1], [-count * 0.2**2 for count in COUNTS], rtol=1e-5), "not of the last episode"


def test_another_body_has_its_own_actions() -> None:
    env = make(grid=(5, 5))
    env.set_designs("mini", torch.tensor([False, True]))
    *_, info = env.step(torch.full((2, env.num_actions), 1.6))
    assert np.allclose(costs(info)[0], -8 * 0.6**2, rtol=1e-6)


def test_actions_before_a_resume_are_known_after_it() -> None:
    env, again = make(), make()
    first, second = torch.full((2, env.num_actions), 1.5), torch.full((2, env.num_actions), 0.7)
    env.step(first)
    again.set_state(env.state())
    for ours, theirs in zip(costs(env.step(second)[4]), costs(again.step(second)[4]), strict=True):
        assert ours == theirs


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_a_single_environment_is_stepped_fast_with_the_numbers_of_torch(dtype: str) -> None:
    env = VoxelEnv(SPEC, body="walker", dtype=dtype)
    slow = make_vec(SPEC, body="walker", device="cpu", dtype=dtype, threads=1, auto_reset=False)
    assert env._fast is not None
    env.reset()
    slow.reset()
    for action in np.random.default_rng(0).uniform(0, 2, (5, env.action_space.shape[0])):
        info, theirs = env.step(action)[4], slow.step(action[None])[4]
        assert info["reward_terms"] == {name: part.item() for name, part in theirs["reward_terms"].items()}
