"""The example design for Lifter-v0 lifts the box, by a fixed sequence of actions."""

from __future__ import annotations

import numpy as np
import pytest

from warpvox.design import example_design
from warpvox.envs.registry import task_ids
from warpvox.envs.vec_env import make_vec
from warpvox.examples import EXAMPLES, MADE_FOR

STEPS = 300
REACH, CLOSE, LIFT, RAMP = 20, 40, 70, 150  # control steps: reach down, close the tips, begin to lift, until it is up


def hoist(body: np.ndarray, step: int) -> np.ndarray:
    """Legs shorten while the inner columns stretch; the tips widen; legs and columns go back together."""
    down, up = min(step / REACH, 1.0), min(max((step - LIFT) / RAMP, 0.0), 1.0)
    leg, column = 1 - 0.4 * down + 0.5 * up, 1 + 0.6 * down - 0.5 * up
    tip = 0.6 if step < CLOSE else 1.5
    outer = (0, body.shape[1] - 1)
    cells = [(column, cell) for (_, column), cell in np.ndenumerate(body) if cell in (3, 4)]
    return np.array([tip if cell == 3 else leg if at in outer else column for at, cell in cells])


def lifted(rules: str, actions) -> tuple[float, float]:
    """Return of the episode and how far the box is above its start at the end, in voxels."""
    body = example_design("lifter")
    env = make_vec(
        "Lifter-v0", [body], device="cpu", dtype="float64", rules=rules, auto_reset=False, threads=1, lanes=1
    )
    env.reset()
    start, total = float(env.sim.com("package")[0, 1]), 0.0
    for step in range(STEPS):
        _, reward, terminated, _, _ = env.step(actions(body, step)[None])
        total += float(reward)
        if terminated:
            break
    return total, (float(env.sim.com("package")[0, 1]) - start) / 0.1


@pytest.mark.parametrize("rules", ["evogym", "paper"])
def test_the_lifter_lifts_the_box_and_holds_it(rules: str) -> None:
    total, height = lifted(rules, hoist)
    assert height > 2
    assert total > 2
    rng = np.random.default_rng(0)
    by_chance, _ = lifted(rules, lambda body, step: rng.uniform(0.6, 1.6, int((body >= 3).sum())))
    assert by_chance < 0.5


def test_examples_are_made_for_tasks_that_there_are_and_fit_them() -> None:
    assert set(MADE_FOR) < set(EXAMPLES)
    for name, tasks in MADE_FOR.items():
        assert set(tasks) <= set(task_ids())
        for task in tasks:
            make_vec(task, [name], device="cpu", threads=1)
