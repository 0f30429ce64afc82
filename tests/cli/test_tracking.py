"""Trainings and searches in Weights & Biases, which a module of its name stands for."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tiny import tiny

STAND_IN = """
import json, os, pathlib

class Run:
    def __init__(self, options):
        self.id, self.summary = options["id"] or f"id{os.getpid()}", self
        tell("init", options)
    def update(self, values): tell("summary", values)
    def log(self, values, step=None): tell("log", values | ({} if step is None else {"step": step}))
    def finish(self, exit_code): tell("finish", exit_code)

def tell(what, value):
    with open(os.environ["TOLD"], "a") as file:
        file.write(json.dumps([what, value]) + "\\n")

def init(**options): return Run(options)
def Image(path): return pathlib.Path(path).read_bytes()[1:4].decode()
def Video(path, format): return pathlib.Path(path).read_bytes()[:3].decode() + format
"""


@pytest.fixture
def told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], dict[str, list[Any]]]:
    """What W&B has been told, by kind; the records begin anew."""
    folder, file = tmp_path / "site", tmp_path / "told"
    folder.mkdir()
    (folder / "wandb.py").write_text(STAND_IN)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("TOLD", str(file))
    monkeypatch.setenv("WANDB_PROJECT", "mine")

    def read() -> dict[str, list[Any]]:
        found: dict[str, list[Any]] = {}
        for what, value in map(json.loads, file.read_text().splitlines()):
            found.setdefault(what, []).append(value)
        file.unlink()
        return found

    return read


def test_a_training_sends_its_configuration_its_rows_and_a_film(train: Callable[..., Path], told: Callable) -> None:
    folder = train("logger=wandb", "max_iterations=2", "name=mine", "design=[mini,worm]", "export=[png]")
    assert (folder / "rollout.png").is_file()
    found = told()
    (options,) = found["init"]
    assert (options["group"], options["tags"], options["id"]) == ("mine", ["Walker-v0", "train"], None)
    assert options["name"] == f"Walker-v0/{folder.name}"
    assert "project" not in options, "WANDB_PROJECT says it"
    assert options["config"]["ppo"]["steps"] == 4
    assert [row.get("step") for row in found["log"]] == [1, 2, None]
    assert {"Loss/value", "Eval/return", "Perf/steps_per_second"} <= found["log"][1].keys()
    assert any(name.startswith("Reward/") for name in found["log"][0])
    assert found["log"][2] == {"film": "GIFgif"}
    assert found["summary"][0]["status"] == "done"
    assert found["finish"] == [0]
    assert list(folder.glob("events.*")), "TensorBoard's events are there as well"


def test_a_resumed_training_goes_on_in_the_same_run(
    train: Callable[..., Path], told: Callable, warpvox: Callable
) -> None:
    folder = train("logger=wandb", "max_iterations=1")
    told()
    warpvox("train", f"resume={folder}", "max_iterations=2", "logger=wandb")
    found = told()
    assert found["init"][0]["id"] == (folder / "wandb_id.txt").read_text()
    assert [row.get("step") for row in found["log"]] == [2, None]


def test_searches_of_one_name_send_their_generations_as_one_group(told: Callable, warpvox: Callable) -> None:
    words = "name=pilot task=Walker-v0 search=random search.max_designs=4 search.population=2 logger=wandb"
    warpvox(*tiny("codesign", *words.split()))
    found = told()
    (folder,) = Path("outputs/codesign/Walker-v0").iterdir()
    (options,) = found["init"]
    assert (options["group"], options["name"]) == ("pilot", f"Walker-v0/{folder.name}")
    assert options["tags"] == ["Walker-v0", "codesign", "random"]
    assert options["config"]["search"]["population"] == 2
    assert [(row["step"], row["Search/evaluations"], row["bodies"]) for row in found["log"][:2]] == [
        (0, 2, "PNG"), (1, 4, "PNG"),
    ]  # fmt: skip
    assert found["log"][0]["Search/best"] <= found["log"][1]["Search/best"]
    assert found["log"][2] == {"film": "GIFgif"}
    assert found["summary"][0]["evaluations"] == 4
    assert found["finish"] == [0]
