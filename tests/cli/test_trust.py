"""Code that a stored file names is imported only if the user names it again; a run carries its code along."""

import ast
import dataclasses
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from tiny import tiny

import warpvox as wv
from warpvox.algos.codesign.robots import robots_of
from warpvox.cli import main
from warpvox.cli.config import load
from warpvox.design import full_connections
from warpvox.errors import ConfigError
from warpvox.robots import Gait, Robot, save_robot

EVIL = "from pathlib import Path\nPath({!r}).touch()\n"
OWN = """
from dataclasses import replace
from pathlib import Path

import steps
from warpvox.envs.registry import get_task

STEPS = steps.count(Path(__file__).with_name("n.txt"))
MINE = replace(get_task("Walker-v0"), id="Mine-v0", max_episode_steps=STEPS)
"""
SEARCH = """
from warpvox.algos.search import BaseSearch


class Mine(BaseSearch):
    def propose(self, rng, count):
        return [self.random_proposal(rng) for _ in range(count)]
"""
PLAY = ["num_envs=1", "threads=1", "device=cpu", "steps=2", "window=off"]
FEW = "search.population=2", "search.max_evaluations=2"


def change_config(folder: Path, **changes: object) -> None:
    """Write into a run's configuration what somebody else may have written."""
    values = yaml.safe_load((folder / "config.yaml").read_text())
    for key, value in changes.items():
        *groups, last = key.split("__")
        inner = values
        for name in groups:
            inner = inner[name]
        inner[last] = value
    (folder / "config.yaml").write_text(yaml.safe_dump(values) + "...\n")


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a training, a design search and robots that name code wherever they can.

    The file ``marker`` in it is made if that code, ``evil.py``, is ever imported.
    """
    home = tmp_path_factory.mktemp("foreign")
    (home / "evil.py").write_text(EVIL.format(str(home / "marker")))
    assert main(tiny("train", f"output_dir={home}/made")) == 0
    assert main(tiny("codesign", "search=random", *FEW, f"output_dir={home}/made")) == 0
    for command, name, changes in (
        ("train", "run", {"task": f"{home}/evil.py:T"}),
        ("train", "own_network", {"policy": "evil:T"}),
        ("codesign", "search", {"task": "evil:T"}),
        ("codesign", "own_search", {"search__algorithm": "custom", "search__make": "evil.py:T"}),
    ):
        shutil.copytree(next((home / "made" / command / "Walker-v0").iterdir()), home / name)
        change_config(home / name, **changes)
    for folder in (home / "search" / "designs").iterdir():
        change_config(folder, task="evil.py:T")
    body = wv.example_design("mini")
    gait = Gait([0], [20], *(np.zeros((1, 8)) for _ in range(3)))
    save_robot(home / "robots/Walker-v0.npz", dataclasses.replace(wv.zoo("BridgeWalker-v0"), task=f"{home}/evil.py:T"))
    save_robot(home / "robots/Gait-v0.npz", Robot("evil:T", body, full_connections(body).T, gait, {"return": 1.0}))
    return home


REFUSED = [
    *("play run=run", "play run=search", "play zoo=robots/Walker-v0.npz", "play zoo=robots/Gait-v0.npz"),
    *("play run=own_network", "evaluate runs=[own_network]", "export run=own_network format=[jit]"),
    *(
        "evaluate runs=[run]",
        "evaluate zoo=[robots/Walker-v0.npz]",
        "export run=run",
        "export zoo=robots/Walker-v0.npz",
    ),
    *("export run=zoo:robots/Walker-v0.npz", "export run=zoo:robots/Gait-v0.npz format=[jit]"),
    *("train resume=run max_iterations=2", "train -m resume=run max_iterations=2,3", "train config=run"),
    *("train config=own_network", "train resume=own_network max_iterations=2", "codesign config=search"),
    *("codesign resume=search", "codesign resume=own_search", "codesign config=own_search"),
]
HARMLESS = [
    *("zoo folder=robots", "zoo folder=robots task=Walker-v0", "zoo folder=robots task=Gait-v0"),
    *("codesign report=search", "play agent=zero design=zoo:robots/Walker-v0.npz steps=1 window=off export=[]"),
    *(
        "export run=run format=[jit]",
        "export run=zoo:robots/Walker-v0.npz format=[jit]",
        "train design=zoo:robots/Walker-v0.npz --cfg job",
    ),
]


@pytest.mark.parametrize("words", [*REFUSED, *HARMLESS])
def test_no_command_runs_code_that_a_file_names(words: str, foreign: Path, warpvox: Callable, monkeypatch) -> None:
    monkeypatch.chdir(foreign)
    before = set(Path().rglob("*"))
    warpvox(*words.split(), fails="names code" if words in REFUSED else None)
    assert not Path("marker").exists()
    assert words in HARMLESS or set(Path().rglob("*")) == before


def test_the_advice_has_each_key_once(foreign: Path, warpvox: Callable) -> None:
    err = warpvox("play", f"run={foreign / 'own_network'}", "policy=mlp", fails="names code").err
    assert err.count("policy=") == 2  # what the file says, and what to type


def test_python_runs_no_code_that_a_file_names(foreign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(foreign)
    assert wv.load_policy("run").num_obs > 0  # needs no task
    for call in (
        lambda: wv.load_policy("zoo:robots/Gait-v0.npz"),
        lambda: wv.load_policy("own_network", policy="stored"),
        lambda: wv.evaluate("own_network"),
        lambda: wv.make_vec("evil.py:T"),
    ):
        with pytest.raises(wv.WarpvoxError):
            call()
    one = wv.evaluate("own_network", policy="evil:T", episodes=1, device="cpu", threads=1)  # which holds layers alone
    assert len(one) == 1
    assert not Path("marker").exists()
    with pytest.raises(ConfigError, match="'T' does not exist"):
        wv.make_vec(wv.Code("evil.py:T"))
    assert Path("marker").exists()
    Path("marker").unlink()


def test_a_cluster_that_a_file_names_is_not_connected_to() -> None:
    base = {"executor": "ray", "address": "evil.example:6379"}
    with pytest.raises(ConfigError, match="names a Ray cluster, address=evil"):
        load("codesign", ["search=ga", "training=fast"], base=base)
    for words in (["address=evil.example:6379"], ["address=null"], ["executor=local"]):
        load("codesign", ["search=ga", "training=fast", *words], base=base)


@pytest.mark.parametrize("service", ["wandb", "neptune"])
def test_an_account_that_a_file_names_is_not_used(service: str) -> None:
    base = {"logger": service}
    with pytest.raises(ConfigError, match=f"logger={service}"):
        load("train", ["seed=1"], base=base)
    for choice in (service, "none"):
        assert load("train", [f"logger={choice}"], base=base).logger == choice


def calls(tree: ast.AST) -> Iterator[str]:
    """Functions that are called, as they are written: ``load``, and of methods ``.load``."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            yield f".{node.func.attr}" if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


def test_only_these_modules_can_run_what_they_read(repository: Path) -> None:
    found: dict[str, set[str]] = {}
    for folder in ("warpvox", "kernels", "envs", "algos", "configs", "examples"):
        for path in (repository / folder).rglob("*.py"):
            for name in calls(ast.parse(path.read_text())):
                found.setdefault(name, set()).add(path.relative_to(repository).as_posix())
    typed = {"warpvox/api.py", "algos/training/loading.py", "warpvox/design_search.py", "warpvox/trust.py"}
    assert found["Code"] == typed
    assert found[".exec_module"] == found["spec_from_file_location"] == {"warpvox/code.py"}
    # of names that stand in the source, and of commands, which are listed there
    names = {"warpvox/code.py", "warpvox/cli/__init__.py", "warpvox/cli/exports.py", "configs/schema.py"}
    names |= {"algos/search/factory.py", "warpvox/evogym/switch.py"}
    names |= {"algos/tracking.py"}
    assert found["import_module"] | found[".import_module"] == names
    assert found[".run_path"] == {"warpvox/evogym/__main__.py"}  # the script that the user names
    assert not {"eval", "exec", "run_path", ".unsafe_load", ".full_load", ".Unpickler"} & found.keys()
    for path in {repository / file for files in found.values() for file in files}:
        text = path.read_text()
        assert "pickle.load" not in text, path
        assert text.count("torch.load(") == text.count("weights_only=True)"), path


@pytest.fixture
def own_task(tmp_path: Path) -> str:
    """A task with neighbours in a folder."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "own.py").write_text(OWN)
    (tmp_path / "mine" / "steps.py").write_text("def count(path):\n    return int(path.read_text())\n")
    (tmp_path / "mine" / "n.txt").write_text("5")
    return "mine/own.py:MINE"


def test_a_run_of_a_custom_task_plays_from_anywhere(train, warpvox, own_task: str, tmp_path, monkeypatch) -> None:
    run = train(f"task={own_task}", "max_iterations=1")
    copied = {path.name for path in (run / "code" / "task").iterdir()}
    assert copied == {"n.txt", "own.py", "steps.py"}
    warpvox("play", f"run={run}", f"task={own_task}", *PLAY)
    (robot,) = robots_of(run)
    save_robot("entries/Mine-v0.npz", dataclasses.replace(robot, task="Mine-v0"))
    refused = warpvox(
        "play", "zoo=entries/Mine-v0.npz", *PLAY, fails="The robot is for Mine-v0, a task of your own: name its code"
    )
    assert "'task=mine/own.py:MINE'" not in refused.err
    warpvox("play", "zoo=entries/Mine-v0.npz", f"task={own_task}", *PLAY)
    place = tmp_path / "far" / "away"
    shutil.move(run, place)
    shutil.rmtree(tmp_path / "mine")
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path / "other")
    refused = warpvox("play", f"run={place}", *PLAY, fails="If you trust it: ")
    pasted = refused.err.split("If you trust it: ")[1].split()
    assert pasted[0] == "warpvox"
    for words in (pasted[1:], ("export", "format=strip", "device=cpu", f"run={place}", "task=stored")):
        warpvox(*words)
    resumed = warpvox("train", f"resume={place}", "max_iterations=2", "device=cpu", "task=stored")
    assert "task=stored" in resumed.out
    assert yaml.safe_load((place / "config.yaml").read_text())["task"] == own_task
    shutil.copytree(place / "code" / "task", "changed")
    Path("changed/steps.py").write_text("def count(path):\n    return 1 + int(path.read_text())\n")
    again = warpvox("train", f"resume={place}", "max_iterations=3", "device=cpu", "task=changed/own.py:MINE")
    assert "not as it was when the run began, its copy is replaced: steps.py" in again.out
    assert "1 +" in (place / "code" / "task" / "steps.py").read_text()


def test_a_search_on_a_custom_task_in_a_module(warpvox: Callable, tmp_path: Path) -> None:
    package = tmp_path / "zoo_of_tasks" / "inner"
    package.mkdir(parents=True)
    (package / "walks.py").write_text(
        OWN.replace("import steps", "from zoo_of_tasks import steps").replace("n.txt", "n")
    )
    (package / "n").write_text("4")
    (package.parent / "steps.py").write_text("def count(path):\n    return int(path.read_text())\n")
    Path("search.py").write_text(SEARCH)
    own = "task=zoo_of_tasks.inner.walks:MINE", "search=custom", "search.make=search.py:Mine"
    outcome = warpvox(*tiny("codesign", *own, *FEW))
    (folder,) = Path("outputs/codesign/Mine-v0").iterdir()
    shutil.rmtree(package.parent)
    Path("search.py").unlink()
    assert f"warpvox play run={folder} task=stored" in outcome.out
    assert f"warpvox play run={folder}/designs/0 task=stored</code>" in (folder / "report.html").read_text()
    for run in (folder, next((folder / "designs").iterdir())):
        warpvox("play", f"run={run}", "task=stored", *PLAY)
    warpvox("codesign", f"resume={folder}", "task=stored", "search.make=stored")
    assert "make: search.py:Mine" in (folder / "config.yaml").read_text()


def test_what_cannot_be_meant(train: Callable, warpvox: Callable, own_task: str) -> None:
    run = train("max_iterations=1")
    (run / "code" / "task").mkdir(parents=True)
    (run / "code" / "task" / "link.py").symlink_to(Path("mine/own.py").resolve())
    for stored, word, message in (
        ("Walker-v0", "task=stored", "has none for task"),
        ("Walker-v0", f"task={own_task}", "task cannot change"),
        ("gone.py:X", "task=stored", "holds no copy of gone.py:X: name the code itself"),
        ("link.py:MINE", "task=stored", "holds no copy of link.py:MINE"),
        ("\x1b[2K\x1b]0;x\x07\n.py:X", "seed=0", r"names code, task=\x1b[2K\x1b]0;x\x07\x0a.py:X"),
    ):
        change_config(run, task=stored)
        warpvox("train", f"resume={run}", "max_iterations=2", word, fails=message)
