"""Learning by the PPO that a graph repeats on CUDA beside rsl-rl's, on the CPU: within what seeds make of it."""

import math
from statistics import mean, variance

import pytest
from learning import ppo_settings, small_env

from warpvox.algos.generators import Generators
from warpvox.algos.training.runner import Runner, Schedule, adapt

SEEDS = range(5)
ENVS, LIMIT = 64, 100
ITERATIONS, LAST = 80, 10
"""Iterations of a training, and those at its end whose mean return counts."""
SIGNIFICANT = 3.36
"""Student's t of 8 degrees of freedom that chance exceeds once in a hundred times, in both directions."""


def final_return(task: str, body: str, seed: int, repeated: bool) -> float:
    """The mean return of the last iterations; ``repeated``: by what a graph repeats on CUDA."""
    ppo = ppo_settings(steps=16, hidden=[64, 64], epochs=5, minibatches=4)
    env = adapt(small_env(ENVS, task=task, designs=[body], lanes=None, max_episode_steps=LIMIT, seed=seed), ppo)
    runner = Runner(env, ppo, Schedule(ITERATIONS, evaluate=10**6), generators=Generators(seed))
    if repeated:
        runner._iteration = runner._make_iteration()
    returns: list[float] = []
    runner.report = lambda row: returns.append(row["return_mean"])
    runner.run()
    return mean([value for value in returns if math.isfinite(value)][-LAST:])


@pytest.mark.slow
@pytest.mark.usefixtures("one_thread")
@pytest.mark.parametrize(
    ("task", "body"), [("Walker-v0", "walker"), ("Carrier-v0", "carrier"), ("UpStepper-v0", "walker")]
)
def test_both_learn_alike(task: str, body: str) -> None:
    stock = [final_return(task, body, seed, False) for seed in SEEDS]
    ours = [final_return(task, body, seed, True) for seed in SEEDS]
    apart = mean(ours) - mean(stock)
    spread = math.sqrt((variance(ours) + variance(stock)) / len(SEEDS))
    print(f"{task}: rsl-rl {stock}, repeated {ours}, t = {apart / spread:.2f}")
    assert abs(apart) < SIGNIFICANT * spread
