"""Tests of repeated trainings: commands with another seed, each starting from the one before."""

from pathlib import Path

import pytest

from lab.zoo import repeats
from lab.zoo.repeats import repeated, store
from lab.zoo.results import read_table, write_table


def test_a_command_is_repeated_with_another_seed_from_the_run_before() -> None:
    first = "warpvox train task=UpStepper-v0 max_iterations=5 'design=[[3,3]]'"
    last = "warpvox train task=Hurdler-v0 seed=3 pretrained=UpStepper-v0/2026-01-01/model_best.pt"
    words = ["warpvox", "train", "task=UpStepper-v0", "max_iterations=5", "design=[[3,3]]", "seed=7"]
    assert repeated(first, 7, None) == words
    assert repeated(last, 7, Path("run")) == ["warpvox", "train", "task=Hurdler-v0", "seed=7", "pretrained=run"]


def test_rows_are_in_the_order_of_tasks_and_seeds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "repeats.csv"
    monkeypatch.setattr(repeats, "REPEATED", path)
    row = {"seed": "1", "noise": "2", "control_steps": "3", "seconds": "4", "processor": "M7", "commit": "c0ffee"}
    write_table(path, [{"task": "Walker-v0"} | row, {"task": "Jumper-v0"} | row])
    store("Walker-v0", 0, 10.25, {"control_steps": 2000, "wall_s": 61.4, "processor": "M7", "commit": "c0ffee"})
    rows = [list(one.values()) for one in read_table(path)]
    assert rows[0] == ["Walker-v0", "0", "10.25", "2000", "61", "M7", "c0ffee"]
    assert [one[:2] for one in rows[1:]] == [["Walker-v0", "1"], ["Jumper-v0", "1"]]
