"""Commands from end to end, on runs of a second."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from warpvox.algos.metrics import COLUMNS, read_metrics
from warpvox.design import example_design, zoo_file
from warpvox.errors import RunError
from warpvox.runs import read_summary
from warpvox.view.rollout import Rollout


def test_a_run_leaves_what_was_promised(train: Callable) -> None:
    folder = train("max_iterations=4", "save_interval=2", "name=first", "seed=3")
    assert folder.parent == Path("outputs/train/Walker-v0")
    assert folder.name.endswith("_first")
    kinds = {file.name.split(".out.")[0] for file in folder.iterdir()}
    assert kinds == {
        "config.yaml", "summary.json", "metrics.csv", "state.pt", "model_best.pt", "model_2.pt", "model_4.pt",
        "events",
    }  # fmt: skip
    config = yaml.safe_load((folder / "config.yaml").read_text())
    assert config["design"] == example_design("mini").tolist()
    assert config["physics"]["preset"] == "evogym"
    assert config["physics"]["gravity"] == 110.0
    assert (config["device"], config["seed"], config["num_envs"]) == ("cpu", 3, 8)
    written = (folder / "metrics.csv").read_text().splitlines()
    assert written[0].split(",") == list(COLUMNS)
    assert [row["iteration"] for row in read_metrics(folder)] == [1, 2, 3, 4]
    figures = read_summary(folder)
    assert figures["status"] == "done"
    assert (figures["iterations"], figures["steps"]) == (4, 4 * 4 * 8)
    assert figures["best_return"] == pytest.approx(read_metrics(folder)[-1]["best_return"], rel=1e-6)


def test_resuming_refuses_what_would_be_another_run(train: Callable, warpvox: Callable) -> None:
    folder = train("max_iterations=1")
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    for word, phrase in {
        "seed=5": "seed cannot change",
        "physics=paper": "physics.preset cannot change",
        "ppo.gamma=0.5": "ppo.gamma cannot change",
        "seed=0 design=mini physics=evogym export=[gif]": "max_iterations=2",  # which changes nothing that is learned
    }.items():
        warpvox("train", f"resume={folder}", *word.split(), fails=phrase)
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before


@pytest.mark.parametrize(
    ("value", "phrase"), [("0", "num_envs must be at least 1, got 0."), ("many", "could not be converted to Integer")]
)
def test_a_stored_value_that_is_not_valid_names_its_file(
    train: Callable, warpvox: Callable, value: str, phrase: str
) -> None:
    config = train("max_iterations=1") / "config.yaml"
    config.write_text(re.sub("num_envs: .*", f"num_envs: {value}", config.read_text()))
    for key in "resume", "config":
        error = warpvox("train", f"{key}={config.parent}", "max_iterations=2", fails=phrase).err
        assert str(config if key == "resume" else config.parent) in error


def test_several_designs_train_together_and_play(train: Callable, warpvox: Callable) -> None:
    folder = train("max_iterations=1", "design=[mini,worm]")
    outcome = warpvox("play", f"run={folder}", "num_envs=2", "steps=3", "threads=1")
    assert "design" in outcome.out
    warpvox("play", f"run={folder}", "num_envs=3", fails="try 2 or 4")
    warpvox("play", f"run={folder}", "steps=3", "threads=1", "name=once")  # once each: equal episodes say no more
    (once,) = Path("outputs/play/Walker-v0").glob("*_once")
    assert len(read_summary(once)["returns"]) == 2


def test_a_body_of_the_zoo_brings_its_task_unless_one_is_given() -> None:
    from warpvox.algos.training.job import Job
    from warpvox.cli.config import load

    for words, task in (
        (["design=zoo:Climber-v0"], "Climber-v0"),
        (["design=zoo:Climber-v0", "task=Walker-v0"], "Walker-v0"),
        (["design=worm"], "Walker-v0"),
        ([f"design=zoo:{zoo_file('Climber-v1', RunError)}"], "Climber-v1"),
    ):
        job = Job(load("train", words), {word.partition("=")[0] for word in words})
        assert job.settings.task == task


def test_play_prints_returns_and_writes_files(train: Callable, warpvox: Callable) -> None:
    train("max_iterations=2")
    outcome = warpvox("play", "num_envs=2", "steps=12", "export=[usd,gif,html]", "threads=1")
    (folder,) = Path("outputs/play/Walker-v0").iterdir()
    names = {file.name for file in folder.iterdir()}
    assert names == {
        "config.yaml", "summary.json", "rollout.npz", "rollout.usd", "rollout.gif", "rollout.html"
    }  # fmt: skip
    assert all(str(folder / name) in outcome.out for name in names if name.startswith("rollout"))
    rollout = Rollout.load(folder / "rollout.npz")
    assert read_summary(folder)["returns"] == pytest.approx(rollout.returns[-1].tolist())
    assert rollout.num_steps == 12


def test_play_repeats_the_best_evaluation(train: Callable, warpvox: Callable) -> None:
    run = train("task=Catcher-v0", "max_iterations=2", "eval_interval=1", "seed=1")  # the best is the second
    warpvox("play", f"run={run}", "num_envs=1", "threads=1")
    (folder,) = Path("outputs/play/Catcher-v0").iterdir()
    assert read_summary(folder)["mean_return"] == pytest.approx(read_summary(run)["best_return"], abs=1e-6)


def test_the_demo_trains_and_exports(warpvox: Callable) -> None:
    words = "design=mini num_envs=8 threads=1 ppo.steps=4 ppo.hidden=[8] max_iterations=1 export=[html]".split()
    outcome = warpvox("demo", *words)
    (folder,) = Path("outputs/train/Walker-v0").iterdir()
    config = yaml.safe_load((folder / "config.yaml").read_text())
    assert (config["preset"], config["stop_return"], config["export"]) == ("demo", 9.0, ["html"])
    assert (folder / "rollout.html").as_posix() in outcome.out
    assert (folder / "rollout.html").resolve().as_uri() in outcome.out
    warpvox("play", "run=latest", "steps=2", "threads=1")


TEAM = """
from dataclasses import replace
from warpvox.envs.registry import get_task

TEAM = replace(get_task("Walker-v0"), id="Team-v0", partners={"mate": (20, 1)})
"""


def test_tasks_of_ones_own_with_several_robots_cell_by_cell(train: Callable, warpvox: Callable) -> None:
    Path("my_own.py").write_text(TEAM)
    folder = train("task=my_own.py:TEAM", "design={robot:mini,mate:[[3,4]]}", "obs=voxel", "max_iterations=1")
    assert folder.parent == Path("outputs/train/Team-v0")
    config = yaml.safe_load((folder / "config.yaml").read_text())
    assert config["design"] == {"robot": example_design("mini").tolist(), "mate": [[3, 4]]}
    assert (config["task"], config["obs"]) == ("my_own.py:TEAM", "voxel")
    assert read_summary(folder)["task"] == "Team-v0"
    words = "task=my_own.py:TEAM", "num_envs=2", "threads=1", "steps=3", "device=cpu"
    outcome = warpvox("play", f"run={folder}", *words)
    assert "Team-v0" in outcome.out
    several = train("task=my_own.py:TEAM", "design=[{robot:mini,mate:worm},{robot:worm,mate:mini}]", "max_iterations=1")
    config = yaml.safe_load((several / "config.yaml").read_text())
    assert config["design"][1] == {
        name: example_design(body).tolist() for name, body in (("robot", "worm"), ("mate", "mini"))
    }


def test_info_names_versions_devices_and_the_cache(warpvox: Callable) -> None:
    outcome = warpvox("info")
    assert outcome.err == ""
    for word in ("warpvox", "warp-lang", "cpu", "cuda", "kernel cache"):
        assert word in outcome.out


def test_help_lists_and_mistakes_do_not_wait_for_torch_and_warp() -> None:
    code = """
import sys
from warpvox.cli import COMMANDS, main
answers = [main([name, "--help"]) for name in COMMANDS] + [main(["tasks"])]
mistakes = [main([name, "sed=3"]) for name in ("train", "codesign", "play", "zoo")]
sys.exit(str((set(answers), set(mistakes), {"torch", "warp", "rsl_rl"} & set(sys.modules))))
"""
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert outcome.stderr.splitlines()[-1] == str(({0}, {2}, set()))
