"""Stable-Baselines3 on a batch of environments: what its interface promises, and its PPO at work."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest
from refusals import refused

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from warpvox.design import example_design
from warpvox.envs.adapters.sb3 import VoxelSB3VecEnv
from warpvox.envs.vec_env import make_vec
from warpvox.errors import ConfigError, SimulationError


def make(**options: object) -> VoxelSB3VecEnv:
    return VoxelSB3VecEnv(**({"task": "Walker-v0", "num_envs": 3, "body": "walker", "threads": 1} | options))


def test_the_body_is_the_one_that_is_named() -> None:
    env = make(body="mini")
    assert env.vec.num_designs == 1
    assert np.array_equal(env.vec.designs[0], example_design("mini"))


@pytest.mark.parametrize("normalize", [True, False])
def test_it_steps_as_the_vector_environment_does(normalize: bool) -> None:
    env = make(max_episode_steps=4, normalize_actions=normalize)
    twin = make_vec("Walker-v0", body="walker", num_envs=3, device="cpu", threads=1, max_episode_steps=4)
    low, high = np.float32((-1, 1) if normalize else (0.6, 1.6))
    assert (env.action_space.low.min(), env.action_space.high.max()) == (low, high)
    assert np.array_equal(env.reset(), twin.reset()[0].numpy())
    rng = np.random.default_rng(0)
    env.vec.episode_length = twin.episode_length = twin.episode_length.new_tensor([0, 1, 2])
    for step in range(5):
        raw = rng.uniform(-1, 1, (3, env.vec.num_actions)).astype(np.float32)
        for sim in (env.vec.sim, twin.sim) if step == 3 else ():
            state = sim.state()
            state["vel"][0] = np.inf  # its end and its limit are the same step
            sim.set_state(state)
        obs, reward, done, infos = env.step(raw if normalize else 1.1 + 0.5 * raw)
        theirs, rewards, terminated, truncated, info = twin.step(1.1 + 0.5 * raw)
        np.testing.assert_allclose(obs, theirs.numpy(), atol=1e-5)
        np.testing.assert_allclose(reward, rewards.numpy(), atol=1e-5)
        assert (obs.dtype, reward.dtype, done.dtype) == (np.float32, np.float32, bool)
        assert done.tolist() == (terminated | truncated).tolist() == [step == 3, step == 2, step == 1]
        for k in range(3):
            assert set(infos[k]) == ({"terminal_observation", "TimeLimit.truncated", "episode"} if done[k] else set())
            if done[k]:
                np.testing.assert_allclose(infos[k]["terminal_observation"], info["final_obs"][k].numpy(), atol=1e-5)
                assert infos[k]["TimeLimit.truncated"] is (k > 0)
                assert infos[k]["episode"]["l"] == 4
                assert infos[k]["episode"]["r"] == pytest.approx(float(info["episode"]["return"][k]), abs=1e-5)


def test_seeds_reach_each_environment_once() -> None:
    env = make(task="Catcher-v0")
    env.seed(5)
    first = env.reset()
    twin = make_vec("Catcher-v0", body="walker", num_envs=3, device="cpu", threads=1)
    assert np.array_equal(first, twin.reset(seed=[5, 6, 7])[0].numpy())
    assert not np.array_equal(env.reset(), first)


def test_its_ppo_learns_on_it_and_is_evaluated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SB3_LOGDIR", str(tmp_path))
    env = VecNormalize(make(max_episode_steps=8))
    model = PPO("MlpPolicy", env, n_steps=16, batch_size=24, n_epochs=1, device="cpu", seed=0)
    model.learn(total_timesteps=96)
    assert model.num_timesteps == 96
    assert len(model.ep_info_buffer) == 12
    assert model.ep_info_buffer[0]["l"] == 8
    mean, _ = evaluate_policy(model, env, n_eval_episodes=3, warn=False)
    assert np.isfinite(mean)


def test_what_it_is_asked_about_its_environments() -> None:
    env = make(render_mode="rgb_array", render_size=(80, 45))
    env.reset()
    assert env.render_mode == "rgb_array"
    assert [picture.shape for picture in env.get_images()] == [(45, 80, 3)] * 3
    assert np.isfinite(env.step(np.full((3, env.vec.num_actions), 1e39))[1]).all()
    assert make().get_images() == [None] * 3
    with pytest.raises(ConfigError):
        make(rulse="paper")
    with pytest.raises(ConfigError):
        make(auto_reset=False)


def test_single_environments_answer_as_those_of_a_dummy_vec_env() -> None:
    ours = make(render_mode="rgb_array", render_size=(80, 45), dtype="float64", normalize_actions=False)
    options = {"body": "walker", "render_mode": "rgb_array", "render_size": (80, 45)}
    theirs = DummyVecEnv([lambda: gymnasium.make("warpvox/Walker-v0", **options) for _ in range(3)])
    for env in (ours, theirs):
        env.seed(4)
        env.reset()
        for value in (0.6, 1.6, 0.6):
            env.step(np.full((3, env.action_space.shape[0]), value, np.float32))
    for indices in (None, 1, [0, 2], range(2)):
        for name in ("render_mode", "render_size", "body", "np_random_seed", "_max_episode_steps", "_elapsed_steps"):
            np.testing.assert_equal(ours.get_attr(name, indices), theirs.get_attr(name, indices), name)
        pictures = ours.env_method("render", indices=indices)
        np.testing.assert_array_equal(pictures, theirs.env_method("render", indices=indices))
        assert ours.env_is_wrapped(Monitor, indices) == theirs.env_is_wrapped(Monitor, indices)
    np.testing.assert_array_equal(ours.render(), theirs.render())
    for env in (ours, theirs):
        env.set_attr("mine", 7)
        env.set_attr("mine", 8, indices=[1])
        assert env.get_attr("mine") == [7, 8, 7]
        assert (env.has_attr("mine"), env.has_attr("others")) == (True, False)
        with refused(AttributeError, "others"):
            env.env_method("others")
        env.set_attr("_max_episode_steps", 4, indices=[2])
        fresh = env.env_method("reset", seed=9, indices=[0])
        assert np.isclose(fresh[0][0], env.reset()[0], atol=1e-6).all()
        ends = [env.step(np.full((3, env.action_space.shape[0]), 1.0, np.float32))[2].tolist() for _ in range(5)]
        assert ends == [[False] * 3] * 3 + [[False, False, True], [False] * 3]


def test_one_environment_is_reset_while_the_others_go_on() -> None:
    env = make()
    first = env.reset()
    for _ in range(5):
        before, *_ = env.step(np.full((3, env.vec.num_actions), 0.9))
    assert env.get_attr("_elapsed_steps") == [5, 5, 5]
    ((obs, info),) = env.env_method("reset", indices=1)
    assert (obs.dtype, info) == (np.float32, {})
    assert np.array_equal(obs, first[1])
    assert not np.array_equal(obs, before[1])
    assert env.get_attr("_elapsed_steps") == [5, 0, 5]
    with pytest.raises(SimulationError):
        env.env_method("step", np.ones(env.vec.num_actions), indices=1)
