"""Task ids, specifications and rules."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import pytest

from warpvox.envs.registry import get_task, released_id, task_ids
from warpvox.envs.spec import Memory, TaskSpec, observes, rewards
from warpvox.envs.terms.observations import shape
from warpvox.envs.terms.rewards import displacement
from warpvox.envs.worlds import block
from warpvox.errors import ConfigError, TaskError


def test_ids_come_in_the_order_of_the_paper() -> None:
    ids = task_ids()
    assert len(ids) == 32
    assert ids[:5] == ["Walker-v0", "BridgeWalker-v0", "BidirectionalWalker-v0", "Carrier-v0", "Carrier-v1"]
    assert ids[-3:] == ["Jumper-v0", "Balancer-v0", "Balancer-v1"]


def test_the_spelling_of_the_release_is_understood() -> None:
    assert get_task("WingspanMazimizer-v0") is get_task("WingspanMaximizer-v0")
    assert released_id("WingspanMaximizer-v0") == "WingspanMazimizer-v0"
    assert released_id("Walker-v0") == "Walker-v0"


def test_all_tasks_with_their_worlds_stay_short(repository) -> None:
    assert sum(len(path.read_text().splitlines()) for path in (repository / "envs" / "tasks").glob("*.py")) < 1000


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
        ({"memory": (Memory("goal", len), Memory("goal", len))}, "several"),
        ({"scattered": ("ground",)}, "no memory named 'offset'"),
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
