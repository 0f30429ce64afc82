"""The tasks as gymnasium has them."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

from warpvox.design import example_design
from warpvox.envs.gym import VoxelEnv, register
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.vec_env import make_vec
from warpvox.errors import ActionError, ConfigError, DesignError, WorldError


@pytest.mark.filterwarnings("ignore:.*For Box action spaces, we recommend:UserWarning")
@pytest.mark.parametrize("task", task_ids())
def test_gymnasium_accepts_the_environment(task: str) -> None:
    env = gymnasium.make(f"warpvox/{task}", body=example_design("walker"))
    assert env.spec.max_episode_steps == get_task(task).max_episode_steps
    check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("task", task_ids())
def test_it_steps_as_the_vector_environment_does(task: str) -> None:
    env = gymnasium.make(f"warpvox/{task}", body=example_design("walker").astype(float))
    twin = make_vec(task, ["walker"], device="cpu", dtype="float64", threads=1)
    obs, info = env.reset(seed=3)
    assert info == {}
    assert obs.dtype == np.float64
    assert obs.tolist() == twin.reset(seed=3)[0][0].tolist()
    rng = np.random.default_rng(0)
    for _ in range(10):
        action = rng.uniform(0.6, 1.6, env.action_space.shape)
        obs, reward, terminated, truncated, info = env.step(action)
        theirs = twin.step(torch.as_tensor(action[None]))
        assert obs.tolist() == theirs[0][0].tolist()
        assert reward == float(theirs[1])
        assert isinstance(reward, float)
        assert (terminated, truncated) == (False, False)
        assert sum(info["reward_terms"].values()) == pytest.approx(reward)
        assert info["unstable"] is False


def test_spaces_are_those_of_evogym() -> None:
    env = gymnasium.make("warpvox/Walker-v0", body=example_design("walker"))
    actuators = int((example_design("walker") >= 3).sum())
    assert env.action_space == gymnasium.spaces.Box(0.6, 1.6, (actuators,), np.float64)
    size = env.reset()[0].shape
    assert env.observation_space == gymnasium.spaces.Box(-100.0, 100.0, size, np.float64)


def test_the_time_limit_is_gymnasiums() -> None:
    env = gymnasium.make("warpvox/Walker-v0", body=[[3, 3], [4, 4]], max_episode_steps=3)
    env.reset()
    ends = [env.step(np.ones(4))[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]


def test_vector_environments_of_gymnasium() -> None:
    envs = gymnasium.make_vec("warpvox/Walker-v0", num_envs=2, body=[[3, 3], [4, 4]])
    obs, _ = envs.reset(seed=1)
    assert obs.shape == (2, 20)
    assert envs.step(envs.action_space.sample())[0].shape == (2, 20)
    envs.close()


def test_registering_twice_does_no_harm(recwarn: pytest.WarningsRecorder) -> None:
    register()
    assert not recwarn.list
    assert {f"warpvox/{task}" for task in task_ids()} <= set(gymnasium.registry)


def test_mistakes_are_named() -> None:
    with pytest.raises(DesignError, match="no actuator"):
        gymnasium.make("warpvox/Walker-v0", body=np.ones((5, 5)))
    with pytest.raises(ConfigError, match="render_mode must be None"):
        VoxelEnv("Walker-v0", render_mode="ascii")
    with pytest.raises(WorldError, match="does not fit"):
        gymnasium.make("warpvox/Climber-v0", body=np.full((2, 6), 3))
    env = gymnasium.make("warpvox/Walker-v0", body=[[3, 3], [4, 4]]).unwrapped
    env.reset()
    with pytest.raises(ActionError, match=r"shape \[4\], got \[3\]"):
        env.step(np.ones(3))
    with pytest.raises(ActionError, match="finite"):
        env.step(np.full(4, np.nan))
