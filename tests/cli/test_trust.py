"""Code that a stored file names is imported only if the user says so; a run of a custom task carries its code along."""

from __future__ import annotations

import io
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import warpvox as wv
from warpvox.cli import trust
from warpvox.cli.config import load
from warpvox.errors import ConfigError
from warpvox.view.rollout import Rollout

EVIL = """
from pathlib import Path

Path({marker!r}).touch()
"""
OWN = """
from dataclasses import dataclass, replace
from pathlib import Path

import steps
from warpvox.envs.registry import get_task

MINE = replace(get_task("Walker-v0"), id="Mine-v0", max_episode_steps=steps.count(Path(__file__).with_name("n.txt")))
"""
SEARCH = """
from warpvox.algos.search import BaseSearch


class Mine(BaseSearch):
    def propose(self, rng, count):
        return [self.random_proposal(rng) for _ in range(count)]
"""
PLAY = ["num_envs=1", "threads=1", "device=cpu", "steps=2", "window=off"]
CODESIGN = (
    "shape=[2,2] search.population=2 search.max_evaluations=2 training.envs=4 training.iterations=1 device=cpu"
    " training.eval_interval=1 training.ppo.steps=4 training.ppo.hidden=[8] training.ppo.epochs=1 threads=1"
).split()


def change_config(folder: Path, **changes: object) -> None:
    """What somebody else may have written."""
    path = folder / "config.yaml"
    values = yaml.safe_load(path.read_text())
    for key, value in changes.items():
        *groups, last = key.split("__")
        inner = values
        for name in groups:
            inner = inner[name]
        inner[last] = value
    path.write_text(yaml.safe_dump(values) + "...\n")


@pytest.fixture
def marker(tmp_path: Path) -> Path:
    """A file that is made if ``evil.py``, or the module ``evil_module``, is ever imported."""
    marker = tmp_path / "marker"
    for name in ("evil.py", "evil_module.py"):
        (tmp_path / name).write_text(EVIL.format(marker=str(marker)))
    return marker


@pytest.fixture
def own_task(tmp_path: Path) -> str:
    """A task with neighbours in a folder."""
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "own.py").write_text(OWN)
    (folder / "steps.py").write_text("def count(path):\n    return int(path.read_text())\n")
    (folder / "n.txt").write_text("5")
    return "mine/own.py:MINE"


def test_the_marker_is_made_by_an_import(marker: Path) -> None:
    from warpvox.envs.sources import load_code

    load_code(str(marker.with_name("evil.py")))
    assert marker.exists()


def test_no_command_imports_the_task_of_a_run(train: Callable, warpvox: Callable, marker: Path, tmp_path: Path) -> None:
    run = train("max_iterations=1")
    before = {path for path in Path("outputs").rglob("*") if path.is_dir()}
    resume = "max_iterations=2", "device=cpu"
    commands = [("play", f"run={run}", *PLAY)]
    more = [("train", f"resume={name}", *resume) for name in ("latest", run / "model_1.pt")]
    more += [("export", f"run={run}", "device=cpu"), ("train", "-m", f"resume={run}", "max_iterations=2,3")]
    more += [("evaluate", f"runs=[{run}]", "device=cpu")]
    tasks = ["evil.py:X", f"{tmp_path}/evil.py:X", "evil_module:X", "evil.py:evil_module:X", "code/evil.py:X"]
    for number, task in enumerate(tasks):
        change_config(run, task=task)
        for words in commands if number else commands + more:
            assert_refused(warpvox(*words), words, f"task={task}")
    (run / "code" / "task").mkdir(parents=True)
    for task in ("evil.py:X", f"{tmp_path}/evil.py:X", "evil_module:X"):
        shutil.copy("evil.py", run / "code" / "task")
        shutil.copy("evil_module.py", run / "code" / "task")
        change_config(run, task=task)
        for words in commands:
            assert_refused(warpvox(*words), words, "task=stored")
    shutil.rmtree(run / "code")
    assert wv.load_policy(run).num_obs > 0  # needs no task
    assert not marker.exists()
    assert "evil_module" not in sys.modules
    assert {path for path in Path("outputs").rglob("*") if path.is_dir()} == before


def assert_refused(outcome: Any, words: tuple[str, ...], key: str) -> None:
    """A refusal that ends in a command to paste."""
    assert outcome.code == 2, words
    assert "names code: task=" in outcome.err
    assert "Traceback" not in outcome.err
    pasted = outcome.err.split("If you trust it: ")[1].split()
    assert [*pasted[:2], pasted[-1]] == ["warpvox", words[0], key]
    assert not any("latest" in word for word in pasted)


def test_no_command_imports_the_code_of_a_search(warpvox: Callable, marker: Path) -> None:
    Path("search.py").write_text(SEARCH)
    outcome = warpvox("codesign", "search=custom", "search.make=search.py:Mine", *CODESIGN)
    assert outcome.code == 0, outcome.err
    (folder,) = Path("outputs/codesign/Walker-v0").iterdir()
    assert (folder / "code" / "search" / "search.py").read_text() == SEARCH
    text = (folder / "config.yaml").read_text()
    change_config(folder, search__make="evil.py:X")
    for words in (("codesign", f"resume={folder}"), ("codesign", "resume=latest", "export=[csv]")):
        outcome = warpvox(*words)
        assert (outcome.code, "names code: search.make=evil.py:X" in outcome.err) == (2, True), outcome.err
    assert warpvox("codesign", f"report={folder}").code == 0  # names it, and needs it not
    (folder / "config.yaml").write_text(text)
    change_config(folder, task="evil_module:X")
    outcome = warpvox("codesign", f"resume={folder}")
    assert (outcome.code, "task=evil_module:X" in outcome.err) == (2, True)
    # a design of the archive, played by way of a link to somewhere else
    elsewhere = folder.parent.parent / "elsewhere"
    shutil.move(folder / "designs", elsewhere)
    (folder / "designs").symlink_to(elsewhere.resolve())
    for design in elsewhere.iterdir():
        change_config(design, task="evil.py:X")
    outcome = warpvox("play", f"run={folder}", *PLAY)
    assert (outcome.code, "names code" in outcome.err) == (2, True)
    assert not marker.exists()
    (folder / "config.yaml").write_text(text)
    done = warpvox("codesign", f"resume={folder}", "search.make=stored")
    assert done.code == 0, done.err
    assert "make: search.py:Mine" in (folder / "config.yaml").read_text()


def test_rollouts_and_dumps_import_nothing(warpvox: Callable, marker: Path) -> None:
    assert warpvox("play", "agent=zero", "design=mini", *PLAY).code == 0
    (file,) = Path("outputs").rglob("rollout.npz")
    rollout = Rollout.load(file)
    rollout.metadata |= {"task": "evil.py:X", "diverged": True, "agent": "evil.py:X", "environment": "evil_module:X"}
    rollout.save("diverged_001_env0.npz")
    for words in (("play", "window=off"), ("export", "format=[html,png]")):
        assert warpvox(*words, "rollout=diverged_001_env0.npz").code == 0
    assert not marker.exists()


def test_a_link_in_place_of_the_copy_is_not_followed(train: Callable, warpvox: Callable, marker: Path) -> None:
    run = train("max_iterations=1")
    change_config(run, task="evil.py:X")
    (run / "code" / "task").mkdir(parents=True)
    (run / "code" / "task" / "evil.py").symlink_to(Path("evil.py").resolve())
    outcome = warpvox("play", f"run={run}", "task=stored", *PLAY)
    assert (outcome.code, "holds no copy" in outcome.err) == (2, True)
    assert not marker.exists()


def test_compiled_code_beside_the_source_is_not_run(
    train: Callable, warpvox: Callable, own_task: str, marker: Path
) -> None:
    """What the user can read in the folder is what is run."""
    import importlib.util
    import py_compile

    run = train(f"task={own_task}", "max_iterations=1")
    helper = run / "code" / "task" / "steps.py"
    shutil.copy(helper, "honest.py")
    good = helper.stat()
    helper.write_text(EVIL.format(marker=str(marker)))
    py_compile.compile(
        str(helper),
        cfile=importlib.util.cache_from_source(str(helper)),
        invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH,
    )
    shutil.copy("honest.py", helper)
    assert good.st_size == helper.stat().st_size
    outcome = warpvox("play", f"run={run}", "task=stored", *PLAY)
    assert outcome.code == 0, outcome.err
    assert not marker.exists()


# --------------------------------------------------------------------------------------------------- consent


def test_a_run_of_a_custom_task_plays_from_anywhere(
    train: Callable, warpvox: Callable, own_task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = train(f"task={own_task}", "max_iterations=1")
    assert sorted(path.name for path in (run / "code" / "task").iterdir()) == ["n.txt", "own.py", "steps.py"]
    expected = warpvox("play", f"run={run}", f"task={own_task}", *PLAY)
    assert expected.code == 0, expected.err
    place = tmp_path / "far" / "away"
    shutil.move(run, place)
    shutil.rmtree(tmp_path / "mine")
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path / "other")
    for words in (("play", *PLAY), ("export", "format=strip", "device=cpu")):
        outcome = warpvox(*words, f"run={place}", "task=stored")
        assert outcome.code == 0, outcome.err
    resumed = warpvox("train", f"resume={place}", "max_iterations=2", "device=cpu", "task=stored")
    assert resumed.code == 0, resumed.err
    assert "task=stored" in resumed.out
    assert yaml.safe_load((place / "config.yaml").read_text())["task"] == own_task
    assert "not as it was" not in resumed.out
    shutil.copytree(place / "code" / "task", "changed")
    Path("changed/steps.py").write_text("def count(path):\n    return 1 + int(path.read_text())\n")
    again = warpvox("train", f"resume={place}", "max_iterations=3", "device=cpu", "task=changed/own.py:MINE")
    assert again.code == 0, again.err
    assert "not as it was when the run began: steps.py" in again.out
    assert "1 +" in (place / "code" / "task" / "steps.py").read_text()
    assert not list(place.rglob("__pycache__"))


def test_a_task_in_a_module_is_kept_with_its_package(
    train: Callable, warpvox: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "zoo_of_tasks" / "inner"
    package.mkdir(parents=True)
    (package / "walks.py").write_text(
        OWN.replace("import steps", "from zoo_of_tasks import steps").replace("n.txt", "n")
    )
    (package / "n").write_text("4")
    (package.parent / "steps.py").write_text("def count(path):\n    return int(path.read_text())\n")
    for name in ("zoo_of_tasks", "zoo_of_tasks.inner", "zoo_of_tasks.inner.walks", "zoo_of_tasks.steps"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    run = train("task=zoo_of_tasks.inner.walks:MINE", "max_iterations=1").resolve()
    shutil.rmtree(package.parent)
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path / "other")
    outcome = warpvox("play", f"run={run}", "task=stored", *PLAY)
    assert outcome.code == 0, outcome.err
    assert "Mine-v0" in outcome.out


def test_a_design_of_a_search_on_a_custom_task(warpvox: Callable, own_task: str) -> None:
    outcome = warpvox("codesign", f"task={own_task}", "search=random", *CODESIGN)
    assert outcome.code == 0, outcome.err
    (folder,) = Path("outputs/codesign/Mine-v0").iterdir()
    shutil.rmtree("mine")
    assert f"warpvox play run={folder.absolute()} task=stored" in outcome.out
    for run in (folder, next((folder / "designs").iterdir())):
        assert warpvox("play", f"run={run}", *PLAY).code == 2
        played = warpvox("play", f"run={run}", "task=stored", *PLAY)
        assert played.code == 0, played.err
    again = warpvox("codesign", f"resume={folder}", "task=stored")
    assert again.code == 0, again.err


class Terminal(io.StringIO):
    """A keyboard and a screen."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def asked(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> Callable[[Path, str], tuple[int, str]]:
    """Play a run at a terminal with this answer: the code, and what was on the screen."""

    def call(run: Path, answer: str) -> tuple[int, str]:
        screen = Terminal()
        with monkeypatch.context() as patch:
            patch.setattr(sys, "stdin", Terminal(answer))
            patch.setattr(sys, "stderr", screen)
            return warpvox("play", f"run={run}", *PLAY).code, screen.getvalue()

    return call


def test_who_sits_at_a_terminal_is_asked(train: Callable, asked: Callable, own_task: str) -> None:
    run = train(f"task={own_task}", "max_iterations=1")
    for answer, code in {"\n": 2, "n\n": 2, "": 2, "yeah\n": 2, "y\n": 0, "yes\n": 0}.items():
        found, screen = asked(run, answer)
        assert found == code, answer
        for word in (str((run / "code" / "task" / "own.py").resolve()), own_task, "n.txt", "steps.py", "[y/N]"):
            assert word in screen


def test_the_question_cannot_be_disguised(train: Callable, asked: Callable) -> None:
    run = train("max_iterations=1")
    change_config(run, task="\x1b[2K\x1b]0;x\x07harmless\n.py:X")
    code, screen = asked(run, "n\n")
    assert code == 2
    assert "\x1b" not in screen
    assert r"\x1b[2K" in screen


def test_what_cannot_be_meant(train: Callable, warpvox: Callable, own_task: str) -> None:
    run = train("max_iterations=1")
    for stored, word, message in (
        ("Walker-v0", "task=stored", "has none for task"),
        ("Walker-v0", f"task={own_task}", "task cannot change"),
        ("gone.py:X", "task=stored", "holds no copy of gone.py:X: name the code itself"),
        ("gone.py:X", "task=Walker-v0", "task cannot change"),
    ):
        change_config(run, task=stored)
        outcome = warpvox("train", f"resume={run}", "max_iterations=2", word)
        assert (outcome.code, message in outcome.err) == (2, True), outcome.err


def test_a_cluster_that_a_file_names_is_not_connected_to(warpvox: Callable) -> None:
    assert warpvox("codesign", "search=random", *CODESIGN).code == 0
    (folder,) = Path("outputs/codesign/Walker-v0").iterdir()
    change_config(folder, executor="ray", address="evil.example:6379")
    outcome = warpvox("codesign", f"resume={folder}")
    assert (outcome.code, "names a Ray cluster, address=evil.example:6379" in outcome.err) == (2, True)
    base = yaml.safe_load((folder / "config.yaml").read_text())
    with pytest.raises(ConfigError, match="Ray cluster"):
        load("codesign", [], base=base, home=folder)
    for words in (["address=evil.example:6379"], ["address=null"], ["executor=local"]):
        load("codesign", words, base=base, home=folder)


def test_large_files_stay_where_they_are(
    train: Callable, warpvox: Callable, own_task: str, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    monkeypatch.setattr(trust, "LARGEST_FILE", 100_000)
    np.save("mine/table.npy", np.zeros(20_000))
    Path("mine/own.py").write_text(OWN + "import numpy\nTABLE = numpy.load(Path(__file__).with_name('table.npy'))\n")
    run = train(f"task={own_task}", "max_iterations=1")
    assert sorted(path.name for path in (run / "code" / "task").iterdir()) == ["n.txt", "own.py", "steps.py"]


def test_a_configuration_to_start_from_imports_nothing(train: Callable, warpvox: Callable, marker: Path) -> None:
    run = train("max_iterations=1")
    change_config(run, task="evil.py:X")
    for file in (run, run / "config.yaml"):
        outcome = warpvox("train", f"config={file}", "max_iterations=1")
        assert (outcome.code, "names code: task=evil.py:X" in outcome.err) == (2, True), outcome.err
    assert not marker.exists()
    assert warpvox("train", f"config={run}", "task=Walker-v0", "max_iterations=1").code == 0
