"""Learning waits for the device no more often than rsl-rl does, and launches no more for many environments."""

from __future__ import annotations

import functools
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest
import torch
from launches import Launches
from rsl_rl.algorithms import PPO as StockPPO
from rsl_rl.runners import OnPolicyRunner

from warpvox.algos.env_factory import EnvFactory
from warpvox.algos.population.ppo import PopulationPPO
from warpvox.algos.population.training import PopulationTraining
from warpvox.algos.training.ppo import PPO, rsl_rl_config
from warpvox.algos.training.runner import Runner, Schedule, adapt
from warpvox.batch.options import SimOptions
from warpvox.cli.config import load
from warpvox.configs.presets import training_preset
from warpvox.design import example_design
from warpvox.envs.adapters.rsl_rl import RslRlVecEnv
from warpvox.envs.vec_env import make_vec
from warpvox.errors import ActionError

STEPS = 5
LOOKS = {("warpvox.simulation", "take")}
LOOKS |= {(f"warpvox.algos.{part}.ppo", "_bootstrap_time_limit") for part in ("training", "population")}
"""Functions that look at tensors on the CPU and at no others (see the last tests)."""


def environments(num_envs: int) -> Any:
    env = make_vec("Walker-v0", ["mini"], num_envs, device="cpu", threads=1, lanes=8, max_episode_steps=3)
    env._on_cpu = False  # as on CUDA
    return env


def settings(steps: int = STEPS) -> Any:
    return load("train", [f"ppo.steps={steps}"]).ppo


def counted(part: Any) -> Launches:
    part()  # the first time makes buffers
    with Launches() as found:
        part()
    return found


def ours(num_envs: int = 8, steps: int = STEPS) -> Runner:
    ppo = settings(steps)
    return Runner(adapt(environments(num_envs), ppo), ppo, Schedule(total=10, evaluate=10**9))


def stock() -> OnPolicyRunner:
    """rsl-rl's own runner and PPO with the same settings, on the same environments."""
    config = rsl_rl_config(settings(), 10)
    wanted = set(StockPPO.__init__.__code__.co_varnames) | {"class_name"}
    config["algorithm"] = {k: v for k, v in config["algorithm"].items() if k in wanted} | {"class_name": "PPO"}
    for name in ("actor", "critic"):
        config[name] |= {"class_name": "MLPModel"}
    config["actor"]["distribution_cfg"] = {"class_name": "GaussianDistribution", "init_std": 1.0}
    return OnPolicyRunner(RslRlVecEnv(environments(8)), config | {"save_interval": 10**9}, log_dir=None, device="cpu")


def waits_of_update(algorithm: Any, env: Any) -> Launches:
    """Of a stored rollout."""
    obs = env.get_observations()

    def collect_and_update() -> Launches:
        nonlocal obs
        with torch.inference_mode():
            for _ in range(STEPS):
                actions = algorithm.act(obs)
                obs, rewards, dones, extras = env.step(actions)
                algorithm.process_env_step(obs, rewards, dones, extras)
            algorithm.compute_returns(obs)
        with Launches() as found:
            algorithm.update()
        return found

    collect_and_update()
    return collect_and_update()


def test_an_update_waits_no_more_often_than_rsl_rls() -> None:
    runner, theirs = ours(), stock()
    assert type(runner.alg) is PPO
    assert type(theirs.alg) is StockPPO
    mine = waits_of_update(runner.alg, runner.env)
    stocks = waits_of_update(theirs.alg, theirs.env)
    assert sum(stocks.waits.values()) >= settings().epochs * settings().minibatches
    assert sum(mine.waits.values()) <= sum(stocks.waits.values())
    assert mine.operations <= stocks.operations


def waits_of_ours(found: Launches) -> dict[tuple[str, str], int]:
    return {place: count for place, count in found.by("warpvox").items() if place not in LOOKS}


def test_no_step_of_a_training_waits() -> None:
    found = [counted(functools.partial(ours(steps=steps).learn, 1)) for steps in (4, 8)]
    assert waits_of_ours(found[0]) == waits_of_ours(found[1]), "more steps, and as many waits"
    assert found[1].kernels - found[0].kernels >= 2 * 4


def test_no_step_of_a_population_waits() -> None:
    found = []
    for steps in (4, 8):
        bodies = [example_design("mini")] * 2
        made = PopulationTraining(
            EnvFactory("Walker-v0", sim=SimOptions("cpu", threads=1)),
            bodies,
            [0, 1],
            training_preset("fast", {"steps": steps}),
        )
        made.env.env._on_cpu = False
        found.append(counted(made.iterate))
    assert waits_of_ours(found[0]) == waits_of_ours(found[1]), "more steps, and as many waits"


def test_launches_do_not_depend_on_the_number_of_environments() -> None:
    runners = ours(8), ours(32)
    for runner in runners:
        runner.alg.schedule = "fixed"  # rsl-rl's other one compares the divergence with one bound or with two
    few, many = (counted(functools.partial(runner.learn, 1)) for runner in runners)
    assert (few.operations, few.kernels) == (many.operations, many.kernels)


def test_what_waits_or_launches_is_counted() -> None:
    values = torch.arange(3.0)
    with Launches() as found:
        values[values > 1]
        values.sum().item()
        values.new_tensor([1.0])
        values.tolist()
        values.view(3, 1)
    assert sum(found.waits.values()) == 4
    env = environments(8)
    env.reset()
    with Launches() as found:
        env.sim.step(torch.ones((8, env.num_actions)))
    assert found.kernels == 2  # the actions and the step
    with pytest.raises(ActionError), Launches() as found:
        env.step(torch.full((8, env.num_actions), torch.nan))
    assert found.by("warpvox")["warpvox.simulation", "take"] > 0


@pytest.mark.parametrize("kind", [PPO, PopulationPPO])
def test_time_limits_are_looked_at_on_the_cpu_alone(kind: type[PPO]) -> None:
    """Tensors on ``meta`` have no values: who looks at them gets an error."""
    critic = MagicMock(side_effect=lambda obs: obs[:, :1], is_recurrent=False)
    rewards, outs = torch.zeros(4, device="meta"), torch.zeros(4, dtype=torch.bool, device="meta")
    with pytest.raises(Exception, match="meta"):
        bool(outs.any())
    found = kind._bootstrap_time_limit(
        SimpleNamespace(gamma=0.99, critic=critic), rewards, outs, torch.zeros((4, 7), device="meta")
    )
    assert found.shape == (4,)
