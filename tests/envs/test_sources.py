"""Files of the user's own are imported as if their folder were the current one, and leave everything as it was."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from warpvox.envs.registry import get_task
from warpvox.envs.sources import find_source, is_code, load_code
from warpvox.errors import TaskError

TASK = """
from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import helper_of_task
from parts.numbers import TWICE
from warpvox.envs.registry import get_task


@dataclass
class Options:
    steps: int = helper_of_task.STEPS


assert Path("steps.txt").read_text() == Path(__file__).with_name("steps.txt").read_text()
MINE = replace(get_task("Walker-v0"), id="Mine-v0", max_episode_steps=Options().steps)
"""


def write_task(folder: Path, steps: int) -> str:
    (folder / "parts").mkdir(parents=True)  # a package without __init__.py
    (folder / "parts" / "numbers.py").write_text("from parts import more\nTWICE = 2 * more.ONE\n")
    (folder / "parts" / "more.py").write_text("ONE = 1\n")
    (folder / "unused.py").write_text("raise RuntimeError\n")
    (folder / "steps.txt").write_text(str(steps))
    (folder / "helper_of_task.py").write_text("STEPS = int(open('steps.txt').read())\n")
    (folder / "task.py").write_text(TASK)
    return f"{folder / 'task.py'}:MINE"


def test_files_find_their_own_neighbours_and_leave_nothing_behind(tmp_path: Path, monkeypatch) -> None:
    here, path, finders = os.getcwd(), list(sys.path), list(sys.meta_path)
    names = {name: write_task(tmp_path / name, steps) for name, steps in (("one", 11), ("two", 22))}
    stranger = type(sys)("helper_of_task")
    stranger.__file__ = str(tmp_path / "elsewhere.py")
    monkeypatch.setitem(sys.modules, "helper_of_task", stranger)
    modules = set(sys.modules)
    assert [get_task(name).max_episode_steps for name in names.values()] == [11, 22]
    assert (os.getcwd(), sys.path, sys.meta_path) == (here, path, finders)
    assert sys.modules["helper_of_task"] is stranger
    assert not {name for name in set(sys.modules) - modules if "task" in name or "parts" in name}
    assert not list(tmp_path.rglob("__pycache__"))
    code = load_code(str(tmp_path / "one" / "task.py"))
    assert [file.relative_to(code.root).as_posix() for file in code.files] == [
        "helper_of_task.py",
        "parts/more.py",
        "parts/numbers.py",
        "task.py",
        "steps.txt",
    ]


def test_two_tasks_of_a_folder_share_their_neighbours(tmp_path: Path) -> None:
    (tmp_path / "shared_thing.py").write_text("THING = object()\n")
    for name in ("a", "b"):
        (tmp_path / f"task_{name}.py").write_text("import shared_thing\n")
    one, two = (load_code(str(tmp_path / f"task_{name}.py")).module for name in ("a", "b"))
    assert one.shared_thing is two.shared_thing


def test_a_failed_import_leaves_nothing_behind(tmp_path: Path) -> None:
    name = write_task(tmp_path / "one", 5)
    (tmp_path / "one" / "steps.txt").unlink()
    here, path, modules = os.getcwd(), list(sys.path), set(sys.modules)
    with pytest.raises(TaskError, match=r"FileNotFoundError.*Relative names of files are looked up beside"):
        get_task(name)
    assert (os.getcwd(), sys.path) == (here, path)
    assert not {name for name in set(sys.modules) - modules if "task" in name or "parts" in name}
    (tmp_path / "one" / "steps.txt").write_text("6")
    assert get_task(name).max_episode_steps == 6


def test_a_file_may_be_named_as_a_module_that_everybody_uses(tmp_path: Path) -> None:
    import json

    (tmp_path / "json.py").write_text(
        "import json\nfrom dataclasses import replace\nfrom warpvox.envs.registry import get_task\n"
        "MINE = replace(get_task('Walker-v0'), id=json.loads('\"Mine-v0\"'))\n"
    )
    assert get_task(f"{tmp_path}/json.py:MINE").id == "Mine-v0"
    assert sys.modules["json"] is json


def test_a_file_of_a_package_is_a_module_of_it(tmp_path: Path) -> None:
    package = tmp_path / "pack_of_tasks" / "inner"
    package.mkdir(parents=True)
    for folder in (package, package.parent):
        (folder / "__init__.py").touch()
    (package.parent / "base.py").write_text("ID = 'Packed-v0'\n")
    (package / "mine.py").write_text(
        "from dataclasses import replace\nfrom ..base import ID\nfrom warpvox.envs.registry import get_task\n"
        "MINE = replace(get_task('Walker-v0'), id=ID)\n"
    )
    assert get_task(f"{package}/mine.py:MINE").id == "Packed-v0"
    assert "pack_of_tasks" not in sys.modules


def test_a_module_that_a_file_lacks_is_named(tmp_path: Path) -> None:
    (tmp_path / "lost.py").write_text("import lost_too\n")
    with pytest.raises(TaskError, match="cannot be imported: ModuleNotFoundError: No module named 'lost_too'"):
        get_task(f"{tmp_path}/lost.py:MINE")


def test_where_code_lies_is_found_without_importing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loud.py").write_text("raise SystemExit\n")
    (tmp_path / "pack").mkdir()
    (tmp_path / "pack" / "__init__.py").write_text("raise SystemExit\n")
    (tmp_path / "pack" / "loud.py").write_text("raise SystemExit\n")
    assert find_source("loud.py") == tmp_path / "loud.py"
    assert find_source("loud") == tmp_path / "loud.py"
    assert find_source("pack.loud") == tmp_path / "pack" / "loud.py"
    assert find_source("nowhere") is find_source("nowhere.py") is None
    assert is_code("a:b")
    assert not any(is_code(name) for name in ("Walker-v0", None, 3))
