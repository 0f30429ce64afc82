"""rsl-rl's own runner on the adapter, with what only it has: networks with a memory."""

from __future__ import annotations

import os

import pytest
import torch

os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")

from rsl_rl.runners import OnPolicyRunner

from warpvox.envs.adapters.rsl_rl import RslRlVecEnv
from warpvox.envs.vec_env import make_vec


def make_runner(kind: str, **options: object) -> OnPolicyRunner:
    env = make_vec("Walker-v0", body="mini", num_envs=8, device="cpu", threads=1, max_episode_steps=6)
    network = {"class_name": kind, "hidden_dims": [8], "activation": "tanh", "obs_normalization": True, **options}
    gaussian = {"class_name": "GaussianDistribution", "init_std": 0.5, "std_type": "log"}
    settings = {
        "num_steps_per_env": 8,
        "save_interval": 1000,
        "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
        "actor": network | {"distribution_cfg": gaussian},
        "critic": network,
        "algorithm": {"class_name": "PPO", "num_learning_epochs": 2, "num_mini_batches": 2, "learning_rate": 1e-3},
    }
    with torch.random.fork_rng():
        torch.manual_seed(0)
        runner = OnPolicyRunner(RslRlVecEnv(env), settings, log_dir=None, device="cpu")
        before = [value.clone() for value in runner.alg.get_policy().parameters()]
        runner.learn(2)
    learned = list(runner.alg.get_policy().parameters())
    assert all(not torch.equal(old, new) for old, new in zip(before, learned, strict=True))
    assert all(bool(torch.isfinite(value).all()) for value in learned)
    return runner


@pytest.mark.parametrize("cell", ["gru", "lstm"])
def test_recurrent_networks_learn_and_forget_at_the_end_of_an_episode(cell: str) -> None:
    runner = make_runner("RNNModel", rnn_type=cell, rnn_hidden_dim=8)
    policy, env = runner.get_inference_policy(), runner.env
    with torch.inference_mode():
        obs = env.reset()
        policy.reset()
        first = policy(obs)
        assert not torch.equal(policy(obs), first)  # it remembers that it has seen this before
        policy.reset(torch.ones(8, dtype=torch.bool))
        torch.testing.assert_close(policy(obs), first)
        done = torch.zeros(8, dtype=torch.bool)
        while not bool(done.any()):
            obs, _, done, extras = env.step(policy(obs))
        assert extras["time_outs"].tolist() == done.tolist()


def test_networks_without_a_memory_do_as_well() -> None:
    runner = make_runner("MLPModel")
    with torch.inference_mode():
        actions = runner.get_inference_policy()(runner.env.get_observations())
    assert tuple(actions.shape) == (8, runner.env.num_actions)
