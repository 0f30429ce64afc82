"""Task ids, specifications, rules and worlds."""

import copy
import dataclasses
import json
import pickle
import sys
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest

from warpvox.code import Code
from warpvox.envs.registry import get_task, released_id, task_ids
from warpvox.envs.spec import TaskSpec, observes, rewards
from warpvox.envs.terms.observations import shape
from warpvox.envs.terms.rewards import displacement
from warpvox.envs.vec_env import make_vec
from warpvox.envs.worlds import block, task_world
from warpvox.errors import ConfigError, TaskError, WorldError
from warpvox.examples import EXAMPLES, MADE_FOR


def test_the_spelling_of_the_release_is_understood() -> None:
    assert get_task("WingspanMazimizer-v0") is get_task("WingspanMaximizer-v0")
    assert released_id("WingspanMaximizer-v0") == "WingspanMazimizer-v0"
    assert released_id("Walker-v0") == "Walker-v0"


def test_a_specification_cannot_be_changed() -> None:
    spec = get_task("Carrier-v0")
    with pytest.raises(dataclasses.FrozenInstanceError):
        spec.max_episode_steps = 1
    with pytest.raises(TypeError):
        spec.paper["max_episode_steps"] = 1
    assert hash(spec.rewards[0]) == hash(get_task("Carrier-v0").rewards[0])


@pytest.mark.parametrize("task", task_ids())
def test_a_specification_can_be_copied_and_sent(task: str) -> None:
    spec = get_task(task)
    for other in (copy.deepcopy(spec), pickle.loads(pickle.dumps(spec))):
        assert other is not spec
        for rules in ("evogym", "paper"):
            one, two = (
                vars(s.under(rules)) | {"paper": 0, "memory": [m.name for m in s.memory]} for s in (spec, other)
            )
            assert one == two


@pytest.mark.parametrize(
    "changes",
    [
        {"observations": ()},
        {"max_episode_steps": 0},
        {"difficulty": "trivial"},
        {"rewards": (observes(shape),)},
        {"rewards": (rewards(displacement, axis="x"), rewards(displacement, axis="x", weight=2.0))},
        {"id": "mine/Walker-v0"},
        {"randomized": ("ground",)},
        {"paper": {"reward": ()}},
        {"paper": {"paper": {}}},
        {"paper": 3},
        {"partners": [1]},
        {"partners": {"other": (1,)}},
        {"partners": {"robot": (9, 1)}},
        {"robot_cell": (1,)},
        {"robot_cell": 1},
        {"robot_cell": (1, 2, 3)},
        {"robot_cell": (1, 2.5)},
        {"rewards": (displacement,)},
        {"rewards": rewards(displacement, axis="x")},
        {"rewards": (rewards(displacement, axis="x", weight=float("nan")),)},
        {"max_episode_steps": 2.5},
    ],
)
def test_specifications_that_make_no_sense_are_refused(changes: dict) -> None:
    fields = {
        "id": "Mine-v0",
        "objects": (block("ground", 10, 1),),
        "robot_cell": (1, 1),
        "max_episode_steps": 10,
        "observations": (observes(shape),),
        "rewards": (rewards(displacement, axis="x"),),
    }
    TaskSpec(**fields)
    with pytest.raises(TaskError):
        TaskSpec(**(fields | changes))


OWN = """
from dataclasses import replace
from warpvox.envs.registry import get_task

MINE = replace(get_task("Walker-v0"), id="Mine-v0")
NUMBER = 3
"""


def test_tasks_of_ones_own_are_found_in_modules_and_files(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_tasks.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "my_tasks", raising=False)
    path = list(sys.path)
    spec = get_task(Code("my_tasks:MINE"))
    assert (spec.id, sys.path) == ("Mine-v0", path)
    assert get_task(Code("my_tasks:MINE")) is spec
    for file in ("my_tasks.py", str(tmp_path / "my_tasks.py")):
        assert get_task(Code(f"{file}:MINE")) is get_task(Code("my_tasks.py:MINE")) is not spec


def test_two_files_have_neighbours_of_their_own(tmp_path) -> None:
    for steps, name in ((11, "one"), (22, "two")):
        (tmp_path / name / "parts").mkdir(parents=True)
        (tmp_path / name / "parts" / "__init__.py").touch()
        (tmp_path / name / "parts" / "numbers.py").write_text(f"STEPS = {steps}\n")
        own = OWN.replace('"Mine-v0"', '"Mine-v0", max_episode_steps=STEPS')
        (tmp_path / name / "json.py").write_text(f"from parts.numbers import STEPS\nimport json\njson.loads\n{own}")
    names = [Code(f"{tmp_path}/{name}/json.py:MINE") for name in ("one", "two")]
    assert [get_task(name).max_episode_steps for name in names] == [11, 22]


def test_a_file_of_a_package_is_a_module_of_it(tmp_path) -> None:
    (tmp_path / "pack_of_tasks" / "inner").mkdir(parents=True)
    for folder in ("pack_of_tasks", "pack_of_tasks/inner"):
        (tmp_path / folder / "__init__.py").touch()
    (tmp_path / "pack_of_tasks" / "base.py").write_text("ID = 'Packed-v0'\n")
    (tmp_path / "pack_of_tasks" / "inner" / "mine.py").write_text(
        "from ..base import ID\n" + OWN.replace('"Mine-v0"', "ID")
    )
    assert get_task(Code(f"{tmp_path}/pack_of_tasks/inner/mine.py:MINE")).id == "Packed-v0"


@pytest.mark.parametrize(
    "name",
    [
        "broken_tasks:MINE",
        "no_tasks_here:MINE",
        "nowhere/my_own.py:MINE",
        "own_tasks:MIEN",
        "own_tasks:NUMBER",
        ":MINE",
    ],
)
def test_tasks_of_ones_own_that_cannot_be_had(tmp_path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    (tmp_path / "own_tasks.py").write_text(OWN)
    (tmp_path / "broken_tasks.py").write_text("nonsense")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_tasks", raising=False)
    with pytest.raises(ConfigError):
        get_task(Code(name))


@pytest.mark.parametrize("task", task_ids())
def test_worlds_have_the_checksums_of_the_reference(task: str) -> None:
    """Place, size and CRC of the cells of every object, as ``tests/parity/record.py --worlds`` has written them."""
    theirs = json.loads((Path(__file__).parent / "worlds.json").read_text())[task]
    ours = {
        obj.name: [obj.x, obj.y, obj.width, obj.height, crc32(obj.grid.tobytes())] for obj in get_task(task).objects
    }
    assert ours == theirs


def test_a_body_that_does_not_fit_is_refused_by_name_of_the_task() -> None:
    beyond = dataclasses.replace(get_task("Walker-v0"), robot_cell=(98, 1))
    with pytest.raises(WorldError):
        task_world(beyond, np.full((3, 3), 3, np.int8))


def test_examples_are_made_for_tasks_that_there_are_and_fit_them() -> None:
    assert set(MADE_FOR) < set(EXAMPLES)
    for name, tasks in MADE_FOR.items():
        assert set(tasks) <= set(task_ids())
        for task in tasks:
            make_vec(task, [name], device="cpu", threads=1)
