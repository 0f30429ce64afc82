"""Random bodies in random tasks: what is valid runs without NaN, what is not is refused with its reason."""

from collections import Counter

import numpy as np
import pytest
import torch
from flood import pieces
from refusals import refused

from warpvox.design import sample_design
from warpvox.envs.adapters.base import spaces_of
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.spec import TaskSpec
from warpvox.envs.vec_env import make_vec
from warpvox.errors import DesignError, WorldError

FEW, MANY = 160, 10_000  # pairs over all tasks
BATCH = 40
STEPS = 25
LARGEST = 8


def draw(rng: np.random.Generator) -> np.ndarray:
    """A body of up to 8 x 8 cells: mostly by EvoGym's rule, some of random cells, fixed and unknown ones among them."""
    shape = tuple(int(n) for n in rng.integers(1, LARGEST + 1, 2))
    if rng.random() < 0.75:
        shape = (min(shape[0], 6), min(shape[1], 6))  # larger ones rarely hang together
        return sample_design(shape, rng, probabilities=(0.3, 0.2, 0.2, 0.2, 0.2))
    kinds = rng.choice([5, 5, 5, 6, 7])  # up to actuators, fixed cells, cells of an unknown type
    return rng.integers(0 if rng.random() < 0.5 else 1, kinds, shape)


def reason(spec: TaskSpec, body: np.ndarray) -> tuple[type[Exception], str] | None:
    """Why this body must be refused, worked out independently; None: it must be taken."""
    if (body > 5).any():
        return DesignError, "unknown cell type 6"
    if not body.any():
        return DesignError, "is empty"
    if (body == 5).any():
        return DesignError, "fixed cell"
    if pieces(body) > 1:
        return DesignError, f"not connected: it falls into {pieces(body)} pieces"
    if not (body >= 3).any():
        return DesignError, "no actuator"
    (x, y), (rows, columns) = spec.robot_cell, body.shape
    for obj in spec.objects:
        for row, column in np.argwhere(obj.grid):
            at = obj.x + column, obj.y + obj.height - 1 - row
            if x <= at[0] < x + columns and y <= at[1] < y + rows:
                return WorldError, f"does not fit the world of {spec.id}: "
    return None


def run(task: str, bodies: list[np.ndarray], rng: np.random.Generator) -> None:
    """Step valid bodies together under random actions, every second action at one of its bounds."""
    rules, dtype = str(rng.choice(["evogym", "paper"])), str(rng.choice(["float32", "float64"]))
    env = make_vec(task, bodies, len(bodies), device="cpu", rules=rules, dtype=dtype, seed=int(rng.integers(1000)))
    low, high = (torch.as_tensor(bound) for bound in (spaces_of(env)[0].low, spaces_of(env)[0].high))
    padding = ~env.obs_mask[env.design_index]
    obs, _ = env.reset()
    for _ in range(STEPS):
        actions = rng.uniform(0.6, 1.6, (env.num_envs, env.num_actions))
        actions = np.where(rng.random(actions.shape) < 0.5, actions, np.where(actions < 1.1, 0.6, 1.6))
        obs, reward, terminated, truncated, info = env.step(actions)
        for values in (obs, reward, info["final_obs"], *info["reward_terms"].values()):
            assert torch.isfinite(values).all(), (task, rules, dtype)
        for seen in (obs, info["final_obs"]):
            assert (seen >= low).all()
            assert (seen <= high).all()
            assert not seen[padding].any()
        assert not truncated.any()
        assert not (info["unstable"] & ~terminated).any()
        assert not env.sim.overflow.any(), (task, rules, dtype)


def check(task: str, count: int, seed: int) -> Counter[str]:
    """Draw so many bodies for a task and see what becomes of them."""
    rng = np.random.default_rng([seed, task_ids().index(task)])
    spec, taken, outcomes = get_task(task), [], Counter()
    for _ in range(count):
        body = draw(rng)
        wrong = reason(spec, body)
        if wrong is None:
            taken.append(body)
        else:
            with refused(*wrong):
                make_vec(task, [body], device="cpu", threads=1)
        outcomes["run" if wrong is None else wrong[1].split(":")[0]] += 1
    for start in range(0, len(taken), BATCH):
        run(task, taken[start : start + BATCH], rng)
    return outcomes


@pytest.mark.parametrize("task", task_ids())
def test_random_bodies(task: str) -> None:
    outcomes = check(task, FEW // len(task_ids()), seed=1)
    assert outcomes["run"]


@pytest.mark.slow
def test_ten_thousand_random_pairs() -> None:
    outcomes: Counter[str] = Counter()
    for number, task in enumerate(task_ids()):
        outcomes += check(task, MANY // len(task_ids()) + (number < MANY % len(task_ids())), seed=2)
    assert outcomes.total() == MANY
    print(dict(outcomes))
    kinds = ("run", "unknown cell type 6", "is empty", "fixed cell", "not connected", "no actuator")
    assert all(outcomes[kind] for kind in kinds), outcomes
    assert any(kind.startswith("does not fit") for kind in outcomes)
    assert outcomes["run"] > MANY / 2
