"""Repeats of a robot's training run the commands of its entry with another seed, each from the one before."""

import dataclasses
from pathlib import Path

import pytest
import repeats
from results import write_table

from warpvox.io.reading import read_table
from warpvox.robots import Robot, zoo

FIRST = "warpvox train task=UpStepper-v0 max_iterations=5 logger=none"
LAST = "warpvox train task=Hurdler-v0 seed=3 logger=none pretrained=UpStepper-v0/2026-01-01/model_best.pt"


def robot(**about: object) -> Robot:
    return dataclasses.replace(zoo("Walker-v0"), about=about)


def test_a_chain_of_trainings_is_run_with_one_seed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folders, ran = iter(["train/UpStepper-v0/stamp_0", "train/Hurdler-v0/stamp_1"]), []

    def run(words: list[str], **_: object) -> None:
        ran.append(" ".join(words[1:]))
        (tmp_path / next(folders)).mkdir(parents=True)

    monkeypatch.setattr(repeats.subprocess, "run", run)
    monkeypatch.setattr(repeats, "robots_of", lambda place, top: iter([robot(place=place)]))
    monkeypatch.setattr(repeats, "recorded", lambda robot, about: robot)
    found = repeats.repeat(robot(start=[{"command": FIRST}], command=LAST), 7, tmp_path)
    assert ran == [
        f"-m warpvox train task=UpStepper-v0 max_iterations=5 logger=none seed=7 output_dir={tmp_path} name=0",
        f"-m warpvox train task=Hurdler-v0 logger=none seed=7 output_dir={tmp_path} name=1"
        f" pretrained={tmp_path}/train/UpStepper-v0/stamp_0/model_best.pt",
    ]
    assert found.about["place"] == tmp_path / "train/Hurdler-v0/stamp_1"


def test_rows_are_in_the_order_of_tasks_and_seeds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "repeats.csv"
    monkeypatch.setattr(repeats, "REPEATED", path)
    row = {"seed": 1, "noise": 2, "control_steps": 3, "seconds": 4, "processor": "M7", "commit": "c0ffee"}
    write_table(path, [{"task": "Walker-v0"} | row, {"task": "Jumper-v0"} | row])
    known = {"noise": {"return": 10.25}, "control_steps": 2000, "wall_s": 61.4, "processor": "M7", "commit": "c0ffee"}
    repeats.store(0, robot(**known))
    rows = [list(one.values()) for one in read_table(path)]
    assert rows[0] == ["Walker-v0", "0", "10.25", "2000", "61", "M7", "c0ffee"]
    assert [one[:2] for one in rows[1:]] == [["Walker-v0", "1"], ["Jumper-v0", "1"]]
