"""Every task under actions that no policy would take, with random bodies that are thrown now and then."""

import numpy as np
import pytest
import torch
from worlds import fixed_rows

from warpvox.design import sample_design
from warpvox.envs.registry import task_ids
from warpvox.envs.vec_env import make_vec
from warpvox.types import ACTION_HIGH, ACTION_LOW

LANES = 32  # environments of a body: those of a pack, so that no lane is idle
THROW_EVERY, THROW_SPEED = 40, 30.0
"""Control steps between throws, and their largest speed: half as fast again as points of a robot ever are."""
FAST = ("Walker-v0", "Climber-v0", "Thrower-v0", "BridgeWalker-v0")


def extreme(step: int, shape: tuple[int, int], rng: np.random.Generator) -> torch.Tensor:
    """Environments in turns: low, high, from bound to bound each step, every ten steps, random, far outside."""
    drawn = rng.uniform(ACTION_LOW, ACTION_HIGH, shape)
    ways = [ACTION_LOW, ACTION_HIGH, *((ACTION_LOW, ACTION_HIGH)[step // length % 2] for length in (1, 10))]
    for k, value in enumerate(ways):
        drawn[k::6] = value
    drawn[5::6] = rng.uniform(-1e6, 1e6, drawn[5::6].shape)
    return torch.as_tensor(drawn)


@pytest.mark.parametrize(
    ("task", "steps", "bodies"),
    [*((task, 100, 1) for task in FAST), *(pytest.param(task, 400, 4, marks=pytest.mark.slow) for task in task_ids())],
)
def test_results_are_finite_and_fixed_points_stay(task: str, steps: int, bodies: int) -> None:
    designs = [sample_design((3 + k % 3, 3 + k % 2), seed=k) for k in range(bodies)]
    env = make_vec(task, designs, LANES * bodies, device="cpu", threads=1)
    rng, sim = np.random.default_rng(0), env.sim
    placed = torch.stack([sim.rows_of(name) for name in sim.object_names if name not in sim.loose]).any(0)
    fixed, free = placed & fixed_rows(sim), placed & ~fixed_rows(sim)
    env.reset(0)
    start = sim.state()["pos"][fixed]
    for step in range(steps):
        if step % THROW_EVERY == THROW_EVERY - 1:
            state = sim.state()
            thrown = torch.as_tensor(rng.random((env.num_envs, 1)) < 1 / 8) & free
            kick = torch.as_tensor(rng.uniform(-THROW_SPEED, THROW_SPEED, (env.num_envs, 2)))
            state["vel"] += torch.where(thrown, kick.repeat(1, thrown.shape[1] // 2), 0.0)
            sim.set_state(state)
        obs, reward, _, _, info = env.step(extreme(step, (env.num_envs, env.num_actions), rng))
        for value in (obs, reward, info["final_obs"], *info["reward_terms"].values()):
            assert torch.isfinite(value).all()
        assert not info["diverged"].any()
    assert torch.equal(sim.state()["pos"][fixed], start)
    assert fixed.any() or task != "BridgeWalker-v0"
