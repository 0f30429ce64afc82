"""Code that a stored file names is imported only if the user names it again."""

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
from warpvox.algos.find import find_run
from warpvox.algos.robots import Robot, gait_policy, save_robot
from warpvox.cli import main
from warpvox.cli.config import load
from warpvox.design import full_connections
from warpvox.errors import ConfigError, StoredCodeError

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
FEW = "search.population=2", "search.max_designs=2"


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
    gait = gait_policy(body, [0], [20], *(np.zeros((1, 8)) for _ in range(3)))
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


def test_a_refusal_says_which_key_what_the_file_has_and_where(foreign: Path) -> None:
    for folder, key, text in (("run", "task", f"{foreign}/evil.py:T"), ("own_network", "policy", "evil:T")):
        with pytest.raises(StoredCodeError) as caught:
            wv.evaluate(foreign / folder, episodes=1)
        assert (caught.value.key, caught.value.text, Path(caught.value.place)) == (key, text, foreign / folder)


def test_python_runs_no_code_that_a_file_names(foreign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(foreign)
    assert wv.load_policy("run").num_obs > 0  # needs no task
    for call in (
        lambda: wv.load_policy("zoo:robots/Gait-v0.npz"),
        lambda: wv.load_policy("run/code/task/evil.py"),
        lambda: wv.evaluate("own_network"),
        lambda: wv.train(resume="run", max_iterations=2),
        lambda: wv.train(resume="own_network", task="Walker-v0", max_iterations=2),
        lambda: wv.make_vec("evil.py:T"),
    ):
        with pytest.raises(wv.WarpvoxError):
            call()
    one = wv.evaluate("own_network", policy="evil:T", episodes=1, device="cpu", threads=1)  # which holds layers alone
    assert len(one) == 1
    assert not Path("marker").exists()
    with pytest.raises(ConfigError):
        wv.make_vec(wv.Code("evil.py:T"))
    assert Path("marker").exists()
    Path("marker").unlink()


def test_no_service_that_a_file_names_is_connected_to(train: Callable, tmp_path: Path) -> None:
    """A Ray cluster could make us run code, a logger send figures to the user's own account."""
    file = tmp_path / "config.yaml"
    file.write_text("executor: ray\naddress: evil.example:6379\nlogger: wandb\n")
    search = load("codesign", [f"config={file}"])
    assert (search.executor, search.address, search.logger) == ("ray", None, "none")
    assert load("codesign", [f"config={file}", "address=here:1"]).address == "here:1"
    for service in ("wandb", "neptune", [3]):
        file.write_text(yaml.safe_dump({"logger": service}))
        assert load("train", [f"config={file}"]).logger == "tensorboard"
        assert load("train", [f"config={file}", "logger=neptune"]).logger == "neptune"
    run = train("max_iterations=1", "logger=none")
    assert find_run(str(run), "").config["logger"] == "none"
    change_config(run, logger="wandb")
    assert "logger" not in find_run(str(run), "").config


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
    passed = {"warpvox/api.py", "algos/training/loading.py", "warpvox/design_search.py", "warpvox/code.py"}
    assert found["Code"] == passed | {"warpvox/cli/commands/design.py"}
    assert found[".exec_module"] == found["spec_from_file_location"] == {"warpvox/code.py"}
    # of names that stand in the source, and of commands, which are listed there
    names = {"warpvox/code.py", "warpvox/cli/__init__.py", "warpvox/cli/exports.py", "configs/schema.py"}
    names |= {"algos/search/factory.py", "warpvox/evogym/switch.py"}
    names |= {"warpvox/progress/tracking.py", "warpvox/cli/sweep.py"}
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


def test_a_run_of_a_custom_task_goes_on_where_its_code_is_named(
    train, warpvox, own_task, tmp_path, monkeypatch
) -> None:
    run = train(f"task={own_task}", "max_iterations=1")
    (copy,) = (run / "code").rglob("*.py")
    assert copy.read_text() == OWN
    warpvox("play", f"run={run}", f"task={own_task}", *PLAY)
    (robot,) = robots_of(run)
    save_robot("entries/Mine-v0.npz", dataclasses.replace(robot, task="Mine-v0"))
    warpvox("play", "zoo=entries/Mine-v0.npz", *PLAY, fails="a task of your own: name its code")
    warpvox("play", "zoo=entries/Mine-v0.npz", f"task={own_task}", *PLAY)

    # Elsewhere, where the file lies in another place
    place = tmp_path / "far" / "away"
    shutil.move(run, place)
    (tmp_path / "mine").rename(tmp_path / "moved")
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path / "other")
    warpvox("play", f"run={place}", *PLAY, fails="name it yourself: task=FILE.py:NAME")
    warpvox("export", f"run={place}", "format=strip", "device=cpu", "task=../moved/own.py:MINE")
    more = "train", f"resume={place}", "max_iterations=2", "device=cpu"
    warpvox(*more, "task=../moved/own.py:OTHER", fails="does not exist")
    resumed = warpvox(*more, "task=../moved/own.py:MINE")
    assert "task=../moved/own.py:MINE" in resumed.out
    assert yaml.safe_load((place / "config.yaml").read_text())["task"] == "../moved/own.py:MINE"


def test_a_search_on_a_custom_task_in_a_module(warpvox: Callable, tmp_path: Path) -> None:
    package = tmp_path / "zoo_of_tasks" / "inner"
    package.mkdir(parents=True)
    (package / "walks.py").write_text(
        OWN.replace("import steps", "from zoo_of_tasks import steps").replace("n.txt", "n")
    )
    (package / "n").write_text("4")
    (package.parent / "steps.py").write_text("def count(path):\n    return int(path.read_text())\n")
    Path("search.py").write_text(SEARCH)
    task = "task=zoo_of_tasks.inner.walks:MINE"
    outcome = warpvox(*tiny("codesign", task, "search=custom", "search.make=search.py:Mine", *FEW))
    (folder,) = Path("outputs/codesign/Mine-v0").iterdir()
    assert f"warpvox play run={folder} {task}" in outcome.out
    assert f"warpvox play run={folder}/designs/0 {task}</code>" in (folder / "report.html").read_text()
    for run in (folder, next((folder / "designs").iterdir())):
        warpvox("play", f"run={run}", task, *PLAY)
    Path("search.py").rename("moved.py")
    warpvox("codesign", f"resume={folder}", task, fails="search.make=FILE.py:NAME")
    warpvox("codesign", f"resume={folder}", task, "search.make=moved.py:Mine")
    assert {file.name for file in (folder / "code").rglob("*.py")} == {"walks.py", "search.py", "moved.py"}


def test_what_cannot_be_meant(train: Callable, warpvox: Callable, own_task: str) -> None:
    run = train("max_iterations=1")
    for stored, word, message in (
        ("Walker-v0", f"task={own_task}", "task cannot change"),
        ("gone.py:X", "task=gone.py:X", "There is no file gone.py"),
        ("\x1b[2K\x1b]0;x\x07\n.py:X", "seed=0", r"names code, task='\x1b[2K\x1b]0;x\x07\n.py:X'"),
    ):
        change_config(run, task=stored)
        warpvox("train", f"resume={run}", "max_iterations=2", word, fails=message)
