"""``warpvox bench suite=stress``: what it sees, what it lets pass, and how deep it says points are."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from warpvox.bench import stress
from warpvox.envs.registry import task_ids
from warpvox.envs.vec_env import make_vec

DEPTH = 1.0
"""Voxels that a point may be inside terrain; less than a tenth of one is usual, thrown bodies reach a half."""
SAMPLE = ("Walker-v0", "Climber-v0", "Thrower-v0", "ObstacleTraverser-v1")


def check(task: str, steps: int, bodies: int = 1) -> None:
    env = make_vec(task, stress.bodies_for(task, bodies, 5, 0), 32 * bodies, device="cpu", threads=1)
    found = stress.stress(env, steps, 0)
    assert found.steps >= steps
    assert (found.not_finite, found.moved, found.diverged) == (0, 0, 0)
    assert found.depth <= DEPTH


@pytest.mark.parametrize("task", SAMPLE)
def test_tasks_bear_extreme_actions_and_throws(task: str) -> None:
    check(task, 3200)


@pytest.mark.slow
@pytest.mark.parametrize("task", task_ids())
def test_every_task_bears_them_for_long(task: str) -> None:
    check(task, 50_000, 4)


def test_the_suite_says_what_it_found(warpvox: Callable) -> None:
    tiny = "suite=stress tasks=[Walker-v0] stress.bodies=1".split()
    outcome = warpvox("bench", *tiny, "stress.steps=64")
    assert outcome.code == 0, outcome.err
    (folder,) = Path("outputs/bench/stress").iterdir()
    found = json.loads((folder / "summary.json").read_text())["tasks"]["Walker-v0"]
    assert found["steps"] == 64
    assert (found["not_finite"], found["moved"]) == (0, 0)
    outcome = warpvox("bench", *tiny, "stress.depth=1e-9", "stress.steps=960", "name=strict")
    assert outcome.code == 2
    assert "These parts failed: " in outcome.err


def test_what_must_not_be_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    env = make_vec("BridgeWalker-v0", num_envs=2, device="cpu", threads=1)
    step, fixed = env.step, env.sim.fixed_rows[0, ::2].nonzero()[0, 0]

    def worse(actions: torch.Tensor) -> tuple:
        result = step(actions)
        result[1][0] = float("nan")
        state = env.sim.state()
        state["pos"][1, 2 * fixed] += 1e-12
        env.sim.set_state(state)
        return result

    monkeypatch.setattr(env, "step", worse)
    found = stress.stress(env, 2, 0)
    assert (found.not_finite, found.moved) == (1, 1)


@pytest.mark.parametrize(
    ("place", "depth"),
    [
        ((3.5, 2.4), 0.6),  # under the open sky
        ((3.5, 3.4), 0.0),
        ((5.25, 3.5), 0.25),  # in the step, from the left
        ((4.9, 2.98), 0.02),
        ((5.1, 2.9), 0.1 * 2**0.5),  # under the edge of the step: the way out is across
        ((6.5, 0.5), (1.5**2 + 2.5**2) ** 0.5),  # up beside the step
        ((9.5, 0.5), 3.0),  # deep inside: as deep as is told apart
        ((-2.0, -0.3), 0.3),  # beside the world there is the floor alone
        ((-2.0, 0.3), 0.0),
    ],
)
def test_depths_are_distances_to_the_open(place: tuple[float, float], depth: float) -> None:
    env = make_vec("Walker-v0", ["mini"], 1, device="cpu", threads=1)
    depths = stress.Depths(env)
    solid = np.zeros((20, 10), bool)
    solid[:, :3] = True
    solid[5:14, 3:8] = True
    depths.solid = np.pad(solid, stress.DEEPEST)[None]
    depths.solid[:, :, : stress.DEEPEST] = True
    assert depths._inside(np.array([[place]]))[0, 0] == pytest.approx(depth)
