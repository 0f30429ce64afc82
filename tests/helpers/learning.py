"""Helpers for tests of trainings: fast settings, a small environment, and comparisons of trainings."""

from pathlib import Path
from typing import Any

import torch
from rsl_rl.algorithms import PPO as StockPPO

from warpvox.algos.metrics import read_metrics
from warpvox.algos.ppo.stock import rsl_rl_config
from warpvox.algos.settings import Ppo
from warpvox.algos.training.runner import Runner
from warpvox.cli.config import load
from warpvox.envs.adapters.rsl_rl import RslRlVecEnv
from warpvox.envs.vec_env import VoxelVecEnv, make_vec

ENVS = 8
TIMING = {"steps_per_second", "elapsed"}


def ppo_settings(**changes: object) -> Ppo:
    """Return the settings of ``ppo=parallel`` with a short rollout, small networks and changes."""
    ppo = load("train", []).ppo
    for name, value in {"steps": 6, "hidden": [8], "epochs": 2, "minibatches": 2, **changes}.items():
        assert hasattr(ppo, name)
        setattr(ppo, name, value)
    return ppo


def small_env(num_envs: int = ENVS, **changes: Any) -> VoxelVecEnv:
    """Create walkers that share one pack of lanes."""
    options = {"task": "Walker-v0", "designs": ["mini"], "device": "cpu", "threads": 1, "lanes": 8} | changes
    return make_vec(num_envs=num_envs, **options)


def stock_ppo(env: RslRlVecEnv, ppo: Ppo, device: str = "cpu") -> StockPPO:
    """Create rsl-rl's own PPO with the same settings."""
    config = rsl_rl_config(ppo, 100) | {"multi_gpu": None}
    config["actor"] |= {"class_name": "MLPModel"}
    config["actor"]["distribution_cfg"] |= {"class_name": "GaussianDistribution"}
    config["critic"] |= {"class_name": "MLPModel"}
    config["algorithm"] |= {"class_name": "PPO"}
    del config["algorithm"]["total_iterations"], config["algorithm"]["adam_eps"]
    made = StockPPO.construct_algorithm(env.get_observations(), env, config, device)
    made.optimizer.param_groups[0]["eps"] = ppo.adam_eps
    return made


def weights(runner: Runner) -> dict[str, torch.Tensor]:
    state = runner.alg.save()
    return {**state["actor_state_dict"], **{f"critic {k}": v for k, v in state["critic_state_dict"].items()}}


def assert_same_weights(one: Runner, other: Runner) -> None:
    """Assert that two networks' weights are equal bit for bit."""
    for name, value in weights(one).items():
        assert torch.equal(value, weights(other)[name]), name


def rows(folder: Path) -> str:
    """Read a run's metrics as text, without timings."""
    return str([{name: value for name, value in row.items() if name not in TIMING} for row in read_metrics(folder)])
