"""The time as an observation: it is the count of the time limit, and nothing else changes."""

import dataclasses

import numpy as np
import pytest
import torch

from warpvox.envs.adapters.rsl_rl import RslRlVecEnv
from warpvox.envs.registry import get_task
from warpvox.envs.vec_env import VoxelVecEnv, make_vec

LIMIT = 4
TEAM = dataclasses.replace(get_task("Walker-v0"), id="Team-v0", partners={"mate": (20, 1)})


def make(task: object, obs: str = "timed", num_envs: int = 3, **options: object) -> VoxelVecEnv:
    defaults = {"designs": ["walker"], "dtype": "float64", "max_episode_steps": LIMIT}
    return make_vec(task, num_envs=num_envs, device="cpu", threads=1, obs=obs, **(defaults | options))


def actions(env: VoxelVecEnv, step: int) -> torch.Tensor:
    count = env.num_envs * env.num_actions
    return (1.1 + 0.5 * torch.sin(0.7 * step + torch.arange(count))).reshape(env.num_envs, -1)


@pytest.mark.parametrize("auto_reset", [True, False])
@pytest.mark.parametrize(
    ("task", "timed", "without"),
    [
        *((task, "timed", "task") for task in ("Walker-v0", "Catcher-v0", "BidirectionalWalker-v0", TEAM)),
        ("Catcher-v0", "timed_voxel", "voxel"),
    ],
)
def test_the_last_number_counts_and_the_others_are_as_without_it(task, timed, without: str, auto_reset: bool) -> None:
    env, plain = make(task, timed, auto_reset=auto_reset), make(task, without, auto_reset=auto_reset)
    assert env.num_obs == plain.num_obs + 1
    obs, theirs = env.reset()[0], plain.reset()[0]
    env.episode_length = plain.episode_length = torch.tensor([0, 2, 0])
    count = np.array([0, 2, 0])
    for step in range(7):
        if step == 3:
            mask = torch.tensor([False, False, True])
            obs, theirs, count = env.reset(mask=mask)[0], plain.reset(mask=mask)[0], count * [1, 1, 0]
            assert obs[:, -1].tolist() == count.tolist()
        assert torch.equal(obs[:, :-1], theirs)
        (obs, *_, info), (theirs, *_, other) = env.step(actions(env, step)), plain.step(actions(env, step))
        count = count + 1 if auto_reset else np.minimum(count + 1, LIMIT)  # an ended episode waits
        assert info["final_obs"][:, -1].tolist() == count.tolist()
        assert torch.equal(info["final_obs"][:, :-1], other["final_obs"])
        count = count % LIMIT if auto_reset else count
        assert obs[:, -1].tolist() == count.tolist()


def test_it_goes_on_from_a_stored_state_and_begins_again_with_another_body() -> None:
    env = make("Walker-v0", designs=["walker", "mini"], num_envs=2, grid=(5, 7), dtype="float32")
    seen = [env.step(actions(env, step))[0] for step in range(2)]
    state = env.state()
    later = env.step(actions(env, 2))[0]
    env.reset()
    env.set_state(state)
    assert torch.equal(env.step(actions(env, 2))[0], later)
    for design, columns in enumerate(env.obs_columns):  # behind the numbers of the body, before the padding
        place = columns["elapsed_steps"]
        assert place.stop == int(env.obs_mask[design].sum())
        assert [float(obs[design, place]) for obs in (*seen, later)] == [1.0, 2.0, 3.0]
    obs = env.set_designs(["worm"], torch.tensor([False, True]))
    times = [float(obs[design, columns["elapsed_steps"]]) for design, columns in enumerate(env.obs_columns)]
    assert times == [3.0, 0.0]


def test_training_that_begins_at_random_ages_sees_them() -> None:
    adapter = RslRlVecEnv(make("Walker-v0"))
    adapter.episode_length_buf = torch.tensor([3, 0, 1])
    assert adapter.get_observations()["policy"][:, -1].tolist() == [3.0, 0.0, 1.0]
    assert adapter.step(torch.zeros(3, adapter.num_actions))[0]["policy"][:, -1].tolist() == [0.0, 1.0, 2.0]
