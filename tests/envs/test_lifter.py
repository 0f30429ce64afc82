"""The example design for Lifter-v0 lifts the box, by a fixed sequence of actions."""

from __future__ import annotations

from warpvox.envs.registry import task_ids
from warpvox.envs.vec_env import make_vec
from warpvox.examples import EXAMPLES, MADE_FOR


def test_examples_are_made_for_tasks_that_there_are_and_fit_them() -> None:
    assert set(MADE_FOR) < set(EXAMPLES)
    for name, tasks in MADE_FOR.items():
        assert set(tasks) <= set(task_ids())
        for task in tasks:
            make_vec(task, [name], device="cpu", threads=1)
