"""Task ids, specifications and rules."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import pytest

from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.spec import TaskSpec, observes, rewards
from warpvox.envs.terms.observations import shape
from warpvox.envs.terms.rewards import displacement
from warpvox.envs.worlds import block
from warpvox.errors import ConfigError, TaskError


def test_ids_come_in_the_order_of_the_paper() -> None:
    assert task_ids() == ["Walker-v0", "Carrier-v0", "Climber-v0", "UpStepper-v0"]


def test_an_unknown_task_names_the_nearest() -> None:
    with pytest.raises(TaskError, match=r"Unknown task 'walker-v0'\. Did you mean 'Walker-v0'\?"):
        get_task("walker-v0")
    with pytest.raises(TaskError, match="Unknown task 5"):
        get_task(5)


def test_a_specification_is_its_own_task() -> None:
    spec = get_task("Walker-v0")
    assert get_task(spec) is spec


def test_unknown_rules_are_refused() -> None:
    with pytest.raises(ConfigError, match="Did you mean 'paper'"):
        get_task("Walker-v0").under("papers")


# steps under both rules; reward, ends and their bonus as section B and the release have them
TABLE = {
    "Walker-v0": (500, 500, {"displacement_robot_x": 1.0}, {"beyond_robot_x": 1.0}),
    "Carrier-v0": (
        500,
        500,
        {"displacement_package_x": 0.5, "displacement_robot_x": 0.5, "drop_package": 10.0},
        {"beyond_robot_x": 1.0},
    ),
    "Climber-v0": (400, 400, {"displacement_robot_y": 1.0}, {"beyond_robot_y": 1.0}),
    "UpStepper-v0": (600, 600, {"displacement_robot_x": 1.0}, {"beyond_robot_x": 2.0, "tilted_robot": -3.0}),
}


@pytest.mark.parametrize("task", task_ids())
def test_steps_weights_and_bonuses(task: str) -> None:
    released, printed, weights, bonuses = TABLE[task]
    assert get_task(task).under("evogym").max_episode_steps == released
    assert get_task(task).under("paper").max_episode_steps == printed
    for rules in ("evogym", "paper"):
        spec = get_task(task).under(rules)
        assert {term.name: term.weight for term in spec.rewards} == weights
        assert {term.name: term.bonus for term in spec.terminations} == bonuses
        assert spec.unstable_penalty == -3.0


ORDER = {
    ("Walker-v0", "evogym"): ["velocity_robot", "shape_robot"],
    ("Walker-v0", "paper"): ["velocity_robot", "shape_robot"],
    ("Carrier-v0", "evogym"): [
        "velocity_robot",
        "separation_package_robot",
        "velocity_package",
        "shape_robot",
    ],
    ("Carrier-v0", "paper"): [
        "velocity_package",
        "separation_package_robot",
        "velocity_robot",
        "shape_robot",
    ],
    ("Climber-v0", "evogym"): ["velocity_robot", "shape_robot"],
    ("Climber-v0", "paper"): ["velocity_robot", "shape_robot"],
    ("UpStepper-v0", "evogym"): ["velocity_robot", "orientation_robot", "shape_robot", "floor_robot"],
    ("UpStepper-v0", "paper"): ["velocity_robot", "orientation_robot", "shape_robot", "elevation_robot"],
}


@pytest.mark.parametrize("rules", ["evogym", "paper"])
@pytest.mark.parametrize("task", task_ids())
def test_order_of_observations(task: str, rules: str) -> None:
    assert [term.name for term in get_task(task).under(rules).observations] == ORDER[task, rules]


def test_a_specification_cannot_be_changed() -> None:
    spec = get_task("Carrier-v0")
    with pytest.raises(dataclasses.FrozenInstanceError):
        spec.max_episode_steps = 1
    with pytest.raises(TypeError):
        spec.paper["max_episode_steps"] = 1
    assert hash(spec.rewards[0]) == hash(get_task("Carrier-v0").rewards[0])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"observations": ()}, "needs an observation"),
        ({"max_episode_steps": 0}, "at least one step"),
        (
            {"rewards": (rewards(displacement, axis="x"), rewards(displacement, axis="x", weight=2.0))},
            "several",
        ),
    ],
)
def test_specifications_that_make_no_sense_are_refused(changes: dict, words: str) -> None:
    fields = {
        "id": "Mine-v0",
        "section": "B.2.1",
        "summary": "",
        "difficulty": "easy",
        "objects": (block("ground", 10, 1),),
        "robot_cell": (1, 1),
        "max_episode_steps": 10,
        "observations": (observes(shape),),
        "rewards": (rewards(displacement, axis="x"),),
    }
    TaskSpec(**fields)
    with pytest.raises(TaskError, match=words):
        TaskSpec(**(fields | changes))


def test_asking_for_ids_does_not_load_torch() -> None:
    code = "import sys, warpvox; warpvox.task_ids(); sys.exit('torch' in sys.modules or 'warp' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
