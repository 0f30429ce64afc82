"""``warpvox bench suite=gpu`` and its parts, in a small size on the CPU."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from rich.console import Console

from warpvox.bench import gpu_checks, gpu_rates
from warpvox.bench import progress as progress_module
from warpvox.bench.report import Report
from warpvox.configs.presets import training_preset
from warpvox.errors import SimulationError

GPU = "bench suite=gpu device=cpu design=mini repeats=1 steps=2 columns=[step] compile=false".split()
CHECKS = ["correctness", "determinism", "independence", "graph"]
SPEEDS = ["sizes", "stages", "bodies", "training", "learning"]
LONG = ["double", "other tasks", "tasks", "recordings", "other tasks, double", "compilation"]


def results() -> tuple[Path, dict]:
    (folder,) = Path("outputs/bench/gpu").iterdir()
    return folder, json.loads((folder / "summary.json").read_text())


def test_every_part_runs(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu_rates, "training_preset", functools.partial(training_preset, envs=8))  # as elsewhere here
    outcome = warpvox(*GPU, "tasks=[Walker-v0,Lifter-v0]", "learning.stop_return=-100")
    assert outcome.code == 0, outcome.err
    figures = results()[1]
    assert figures["failed"] == figures["left_out"] == []
    assert list(figures["seconds"]) == CHECKS + SPEEDS + LONG
    assert {row["task"] for row in figures["tasks"]} == {"Walker-v0", "Lifter-v0"}
    assert [figures[part][0]["task"] for part in ("correctness", "other tasks")] == ["Walker-v0", "Lifter-v0"]
    assert [row["num_envs"] for row in figures["sizes"]] == [1, 8]
    assert all(row["physics"]["block 64"] > 0 < row["step"] for row in figures["sizes"])
    assert figures["bodies"][0]["different"] > 0
    assert figures["training"][0]["training"] > 0 < figures["training"][-1]["rate"]
    assert "equal bit for bit" in outcome.out
    assert outcome.out.count("designs of 8 environments side by side") == 1


def test_what_was_found_is_kept_when_the_call_is_cut_off(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    saved = []
    write = progress_module.write_summary
    monkeypatch.setattr(progress_module, "write_summary", lambda *content: (saved.append(1), write(*content)))

    def cut_off(*_: object) -> None:
        assert len(saved) >= 6, "each row is saved by itself"
        raise KeyboardInterrupt

    monkeypatch.setattr(gpu_rates, "stage_times", cut_off)
    assert warpvox(*GPU, "tasks=[Walker-v0]").code == 130
    folder, figures = results()
    assert list(figures["seconds"]) == [*CHECKS, "sizes", "stages"]
    assert figures["correctness"][0]["good"] is True
    assert len(figures["sizes"]) == 2
    assert figures["machine"]["warp"]
    assert "predicted for 8 threads an environment" in (folder / "tables.md").read_text()


def test_a_part_that_fails_does_not_stop_the_others(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(gpu_checks.POSITION, "float32", 1e-30)
    for part in ("sizes", "stages", "bodies", "training", "learning", "tasks"):
        monkeypatch.setattr(gpu_rates, part, lambda *_: None)
    outcome = warpvox(*GPU, "tasks=[Walker-v0]")
    assert outcome.code == 2
    assert "These parts failed: correctness" in outcome.err
    figures = results()[1]
    assert figures["failed"] == ["correctness"]
    assert figures["correctness"][0]["good"] is False
    assert figures["determinism"]["steps"] > 0


def test_no_part_begins_when_the_time_is_over(warpvox: Callable) -> None:
    outcome = warpvox(*GPU, "tasks=[Walker-v0]", "seconds=1e-6")
    assert outcome.code == 0, outcome.err
    assert len(results()[1]["left_out"]) == 13
    assert "Left out, for the 1e-06 s were over: correctness, determinism" in " ".join(outcome.out.split())


def test_the_time_ends_within_a_part_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(progress_module.time, "perf_counter", lambda: now[0])
    progress = progress_module.Progress(Report(Console(quiet=True), tmp_path), {}, seconds=10.0)

    def tasks() -> None:
        for name in ("one", "two", "three"):
            if progress.time_for(f"tasks: {name}"):
                progress.row("tasks", name, task=name)
            now[0] += 6.0

    progress.run("tasks", tasks)
    figures = progress.close()
    assert [row["task"] for row in figures["tasks"]] == ["one", "two"]
    assert figures["left_out"] == ["tasks: three"]
    assert figures["seconds"] == {"tasks": 18.0}


def test_without_a_gpu_its_suite_says_so(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    outcome = warpvox("bench", "suite=gpu")
    assert outcome.code == 2
    assert "no CUDA device was found" in outcome.err
    assert not Path("outputs").exists()


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        (("Walker-v0", "float32", 16384), "6.60 to 13.3 M"),
        (("Walker-v0", "float64", 16384), "-"),
        (("Climber-v0", "float32", 16384), "-"),
        (("Walker-v0", "float32", 8), "-"),
    ],
)
def test_predictions_stand_beside_what_was_predicted_for(asked: tuple, told: str) -> None:
    assert gpu_rates.predicted(*asked) == told


@pytest.mark.parametrize("offset", [0.0, 1e-300])
def test_equal_bit_for_bit_is_tested(offset: float) -> None:
    one, other = ({"pos": torch.full((3,), value, dtype=torch.float64)} for value in (0.0, offset))
    with pytest.raises(SimulationError, match="differ in pos") if offset else nullcontext():
        gpu_checks._compare(one, other, "Runs")


@pytest.mark.parametrize("code", [0, 1])
def test_the_tests_of_this_checkout_are_run(
    code: int, tmp_path: Path, repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words: list[str] = []

    def tests(command: list[str], **_: object) -> SimpleNamespace:
        words.extend(command)
        return SimpleNamespace(stdout="2 passed\n", returncode=code)

    monkeypatch.setattr(gpu_checks.subprocess, "run", tests)
    with pytest.raises(SimulationError, match="2 passed") if code else nullcontext():
        found = gpu_checks.recordings(SimpleNamespace(device="cuda:0"), Report(Console(quiet=True), tmp_path), 60.0)
        assert found == {"replayed": True, "result": "2 passed"}
    assert words[-1] == str(repository / "tests")
