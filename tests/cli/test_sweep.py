"""Folders of sweeps say what their runs differ by; one that fails does not end the others."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from tiny import tiny

import warpvox as wv
from warpvox.algos.metrics import read_metrics
from warpvox.cli.sweep import LONGEST_LABEL, label_of
from warpvox.design import example_design
from warpvox.devices.startup import LOGGER
from warpvox.errors import DivergenceError
from warpvox.runs import check_name
from warpvox.system import processor_name


@pytest.mark.parametrize("value", ["a/b/body (1).json", "[[3,3],[4,4]]", "läufe", "", "../..", "x" * 400])
def test_labels_are_short_and_safe(value: str) -> None:
    label = label_of({"design": value, "ppo.hidden": "[64,64]"})
    assert len(label) <= LONGEST_LABEL
    check_name(label)
    assert label.startswith("design-")
    assert label_of({"seed": "1", "ppo.gamma": "0.9", "task": "Walker-v0"}) == "seed-1_ppo.gamma-0.9"


def test_the_folders_of_a_sweep_say_what_their_runs_differ_by(warpvox: Callable) -> None:
    outcome = warpvox(*tiny("train", "-m", "seed=1,2", "ppo.gamma=0.9,0.99", "name=x"))
    folders = sorted(Path("outputs/train/Walker-v0").iterdir(), key=lambda one: one.stat().st_ctime_ns)
    assert [folder.name.split("_", 2)[2] for folder in folders] == [
        f"x_seed-{seed}_ppo.gamma-{gamma}" for seed in (1, 2) for gamma in (0.9, 0.99)
    ]
    config = yaml.safe_load((folders[1] / "config.yaml").read_text())
    assert (config["seed"], config["ppo"]["gamma"], config["num_envs"]) == (1, 0.99, 8)
    assert re.findall(r"run \d: seed=\d ppo.gamma=0.99?", outcome.out)[1] == "run 2: seed=1 ppo.gamma=0.99"
    warpvox("play", "run=latest", "num_envs=1", "steps=2", "threads=1", "export=[]", "window=off")


def test_lists_presets_and_paths_with_commas_can_be_swept(warpvox: Callable, monkeypatch) -> None:
    found = []
    monkeypatch.setattr("warpvox.cli.commands.play.run", lambda config, *_: found.append((config.run, config.export)))
    Path("a,b").mkdir()
    warpvox("play", "-m", "export=gif,[usd,gif]", "run=a,b", "window=off")
    assert found == [("a,b", ["gif"]), ("a,b", ["usd", "gif"])]
    found.clear()
    monkeypatch.setattr("warpvox.cli.commands.train.run", lambda config, *_: found.append(config.preset))
    warpvox("train", "-m", "preset=paper,universal")
    assert found == ["paper", "universal"]


@pytest.mark.parametrize("words", [(), ("hydra/launcher=basic",)])
def test_a_member_that_fails_does_not_end_the_sweep(warpvox: Callable, monkeypatch, words: tuple[str, ...]) -> None:
    """Also of a launcher of Hydra: those that are installed besides are called by the interface of its own one."""
    from warpvox.algos.training.runner import Runner

    run = Runner.run

    def fail_once(self: Runner) -> None:
        if self.env.env.seed == 1:
            raise DivergenceError("it diverged")
        run(self)

    monkeypatch.setattr(Runner, "run", fail_once)
    outcome = warpvox(*tiny("train", "-m", *words, "seed=1,2", "name=x"), code=2)
    assert "failed: it diverged" in outcome.out
    assert outcome.err.splitlines()[-1] == "warpvox: it diverged"
    assert not LOGGER.disabled  # Hydra's configuration of logs can switch off those that there are
    assert [path.name.partition("_x")[2] for path in Path("outputs/train/Walker-v0").iterdir()] == ["_seed-2"]


def test_an_interrupt_ends_a_sweep(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    from warpvox.algos.training.runner import Runner

    made = []

    def interrupt(self: Runner) -> None:
        made.append(self)
        raise KeyboardInterrupt

    monkeypatch.setattr(Runner, "run", interrupt)
    warpvox(*tiny("train", "-m", "seed=1,2,3"), code=130)
    assert len(made) == 1


def test_a_summary_says_what_made_it(train: Callable, repository: Path) -> None:
    summary = json.loads((train("max_iterations=1", "seed=5") / "summary.json").read_text())
    assert (summary["seed"], summary["version"]) == (5, wv.__version__)
    assert summary["design"] == example_design("mini").tolist()
    assert summary["processor"] == processor_name()
    if (repository / ".git").exists():
        assert len(summary["commit"].removesuffix("-dirty")) == 40
    else:
        assert summary["commit"] is None


def test_resuming_says_why_there_is_nothing_to_do_and_how_to_go_on(train: Callable, warpvox: Callable) -> None:
    folder = train("max_iterations=2")
    for words in ([], ["max_iterations=2"], ["max_iterations=1"]):
        outcome = warpvox("train", "resume=latest", *words, fails="already made 2 iterations")
        advice = outcome.err.strip().partition("Go on with: warpvox ")[2]
        assert advice == f"train resume={folder} max_iterations=4"
    warpvox(*advice.split())
    assert [row["iteration"] for row in read_metrics(folder)] == [1, 2, 3, 4]
    before = (folder / "summary.json").read_text()
    earlier = min(folder.glob("model_[0-9].pt"), key=lambda file: file.name)
    asked = f"max_iterations={earlier.stem[6:]}"
    warpvox("train", f"resume={earlier}", asked, fails=f"{asked} asks for no more")  # nothing is learned, nor told
    assert (folder / "summary.json").read_text() == before


def test_resuming_an_interrupted_run_to_less_than_it_has(train: Callable, warpvox: Callable) -> None:
    folder = train("max_iterations=2")
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps(summary | {"status": "interrupted"}))
    assert "only the summary was missing; for more" in warpvox("train", "resume=latest", "max_iterations=2").out
    assert json.loads((folder / "summary.json").read_text())["status"] == "done"
    (folder / "summary.json").write_text(json.dumps(summary | {"status": "interrupted"}))
    before = (folder / "config.yaml").read_bytes()
    warpvox("train", "resume=latest", "max_iterations=1", fails="already made 2 iterations")
    assert (folder / "config.yaml").read_bytes() == before


def test_a_run_that_has_reached_its_return(train: Callable, warpvox: Callable) -> None:
    folder = train("max_iterations=4", "stop_return=-1000", "eval_interval=1")
    outcome = warpvox("train", "resume=latest", "max_iterations=8", fails="already reached stop_return=-1000")
    advice = outcome.err.strip().partition("Go on with: warpvox ")[2]
    warpvox(*advice.split(), "max_iterations=2")
    assert read_metrics(folder)[-1]["iteration"] == 2
