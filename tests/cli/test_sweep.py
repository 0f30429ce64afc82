"""Sweeps say in folders, tables and CSV what their runs differ by; one that fails does not end the others."""

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from tiny import tiny

import warpvox as wv
from warpvox.algos.training.metrics import read_metrics
from warpvox.cli import sweep
from warpvox.cli.sweep import LONGEST_LABEL, label_of
from warpvox.design import example_design
from warpvox.devices.startup import LOGGER
from warpvox.errors import DivergenceError
from warpvox.system import processor_name


def table() -> list[dict[str, str]]:
    (file,) = Path("outputs/train").glob("sweep_*.csv")
    with file.open(encoding="utf-8", newline="") as text:
        return list(csv.DictReader(text))


@pytest.mark.parametrize("value", ["a/b/body (1).json", "[[3,3],[4,4]]", "läufe", "", "../..", "x" * 400])
def test_labels_are_short_and_safe(value: str) -> None:
    label = label_of({"design": value, "ppo.hidden": "[64,64]"})
    assert len(label) <= LONGEST_LABEL
    assert set(label) <= set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._+-")
    assert label.startswith("design-")
    assert label_of({"seed": "1", "ppo.gamma": "0.9", "task": "Walker-v0"}) == "seed-1_ppo.gamma-0.9"


def test_a_sweep_leaves_a_table(warpvox: Callable) -> None:
    outcome = warpvox(*tiny("train", "-m", "seed=1,2", "ppo.gamma=0.9,0.99", "name=x"))
    folders = sorted(
        Path("outputs/train/Walker-v0").iterdir(), key=lambda folder: (folder / "config.yaml").stat().st_mtime_ns
    )
    assert [folder.name.split("_", 2)[2] for folder in folders] == [
        f"x_seed-{seed}_ppo.gamma-{gamma}" for seed in (1, 2) for gamma in (0.9, 0.99)
    ]
    rows = table()
    assert [(row["seed"], row["ppo.gamma"], row["status"]) for row in rows] == [
        (str(seed), str(gamma), "done") for seed in (1, 2) for gamma in (0.9, 0.99)
    ]
    for row, folder in zip(rows, folders, strict=True):
        assert Path(row["folder"]) == folder
        assert float(row["best_return"]) == json.loads((folder / "summary.json").read_text())["best_return"]
    assert "4 of 4 runs" in outcome.out
    assert re.findall(r"run (\d) of 4(, left 0:00:\d\d)?:", outcome.out)[0] == ("1", "")
    assert all(left for _, left in re.findall(r"run (\d) of 4(, left 0:00:\d\d)?:", outcome.out)[1:])
    (command,) = re.findall(r"compare: warpvox (curves runs=\S+)", outcome.out)
    warpvox(*command.split())
    warpvox("play", "run=latest", "num_envs=1", "steps=2", "threads=1", "export=[]", "window=off")


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
    last = warpvox(*tiny("train", "-m", *words, "seed=1,2", "name=x"), code=2).err.splitlines()[-1]
    assert last.startswith("warpvox: 1 of 2 runs failed, the first of them with: it diverged")
    assert not LOGGER.disabled  # Hydra's configuration of logs can switch off those that there are
    assert [(row["run"], row["seed"], row["status"]) for row in table()] == [("1", "1", "failed"), ("2", "2", "done")]
    assert [path.name.partition("_x")[2] for path in Path("outputs/train/Walker-v0").iterdir()] == ["_seed-2"]


def test_an_interrupt_ends_a_sweep_with_its_table(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    from warpvox.algos.training.runner import Runner

    def interrupt(self: Runner) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Runner, "run", interrupt)
    outcome = warpvox(*tiny("train", "-m", "seed=1,2,3"), code=130)
    assert [row["status"] for row in table()] == ["interrupted"]
    assert "1 of 3 runs" in outcome.out


def test_keys_with_the_name_of_a_column_of_the_table(warpvox: Callable) -> None:
    words = ("play", "-m", "run=runs/a,runs/b", "steps=1,2", "window=off")
    warpvox(*words, fails="4 of 4 runs failed, the first of them with: There is no run at runs/a")
    (file,) = Path("outputs/play").glob("sweep_*.csv")
    with file.open(encoding="utf-8", newline="") as text:
        rows = [(row["run"], row["key_run"], row["key_steps"], row["status"]) for row in csv.DictReader(text)]
    runs = [(run, steps) for run in ("runs/a", "runs/b") for steps in "12"]
    assert rows == [(str(number + 1), *values, "failed") for number, values in enumerate(runs)]


def test_a_sweep_of_searches_has_a_folder_before_its_first_run(warpvox: Callable, monkeypatch) -> None:
    """Another one that begins in the same second takes another; and a setting may be one of the searches' alone."""
    found = []
    monkeypatch.setattr(sweep, "run_hydra", lambda *_: found.extend(Path("out/codesign").glob("sweep_*")))
    warpvox("codesign", "-m", "search=bo,bo_lbfgs", "search.candidates=500", "output_dir=out")
    assert [path.name[:6] for path in found] == ["sweep_"]
    assert not Path("out").exists()


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
