"""``warpvox bench suite=gpu`` and its parts, in a small size on the CPU."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from rich.console import Console
from simulated_cuda import SimulatedCuda

from warpvox.bench import cases, gpu, gpu_checks, gpu_rates, gpu_tools, report as report_module
from warpvox.bench.machine import machine
from warpvox.bench.report import Report
from warpvox.cli.config import load
from warpvox.envs import memory
from warpvox.errors import SimulationError
from warpvox.types import Physics

GPU = "bench suite=gpu device=cpu design=mini repeats=1 steps=2 columns=[step]".split()
CHECKS = ["smoke", "correctness", "determinism", "independence"]
FIGURES = ["sizes", "profile", "training", "learning"]
LONG = ["recordings", "other tasks", "double", "bodies", "tasks", "other tasks, double"]


def results() -> tuple[Path, dict]:
    (folder,) = Path("outputs/bench/gpu").iterdir()
    return folder, json.loads((folder / "summary.json").read_text())


def test_every_part_runs(warpvox: Callable) -> None:
    outcome = warpvox(*GPU, "tasks=[Walker-v0,Lifter-v0]", "learning.stop_return=-100")
    figures = results()[1]
    assert figures["failed"] == figures["left_out"] == []
    assert list(figures["seconds"]) == CHECKS + FIGURES + LONG
    assert {row["task"] for row in figures["tasks"]} == {"Walker-v0", "Lifter-v0"}
    assert [figures[part][0]["task"] for part in ("correctness", "other tasks")] == ["Walker-v0", "Lifter-v0"]
    assert [row["num_envs"] for row in figures["sizes"]] == [1, 8]
    assert all(row["physics"] > 0 < row["step"] for row in figures["sizes"])
    assert "aten::mm" in (results()[0] / "profile.txt").read_text()
    assert figures["bodies"][0]["different"] > 0
    assert figures["training"][0]["training"] > 0 < figures["training"][-1]["rate"]
    assert "equal bit for bit" in outcome.out
    assert outcome.out.count("designs of 8 environments side by side") == 1


def test_what_was_found_is_kept_when_the_call_is_cut_off(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    saved = []
    write = report_module.write_summary
    monkeypatch.setattr(report_module, "write_summary", lambda *content: (saved.append(1), write(*content)))

    def cut_off(*_: object) -> None:
        assert len(saved) >= 7, "each row is saved by itself"
        raise KeyboardInterrupt

    monkeypatch.setattr(gpu_tools, "profile", cut_off)
    warpvox(*GPU, "tasks=[Walker-v0]", code=130)
    folder, figures = results()
    assert list(figures["seconds"]) == [*CHECKS, "sizes", "profile"]
    assert figures["correctness"][0]["good"] is True
    assert len(figures["sizes"]) == 2
    assert figures["machine"]["warp"]
    assert "step only" in (folder / "tables.md").read_text()


def test_a_part_that_fails_does_not_stop_the_others(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(gpu_checks.TOLERANCES["float32"], "pos", 1e-30)
    for part in ("sizes", "bodies", "training", "learning", "tasks"):
        monkeypatch.setattr(gpu_rates, part, lambda *_: None)
    monkeypatch.setattr(gpu_tools, "profile", lambda *_: None)
    warpvox(*GPU, "tasks=[Walker-v0]", fails="These parts failed: correctness")
    figures = results()[1]
    assert figures["failed"] == ["correctness"]
    assert figures["correctness"][0]["good"] is False
    assert figures["determinism"]["steps"] > 0


@pytest.fixture
def report(tmp_path: Path) -> Report:
    return Report(Console(quiet=True), tmp_path, {"machine": machine("cpu")})


def config_of(*words: str) -> Any:
    return load("bench", ["suite=gpu", "repeats=1", "steps=2", "threads=1", *words])


@pytest.mark.parametrize("task", ["Climber-v2", "Lifter-v0", "Thrower-v0", "Carrier-v0"])
def test_float32_is_right_where_contacts_part_its_trajectories(task: str, report: Report) -> None:
    """Over 30 control steps from one state some environments of these tasks are 1e-5 to 1e-3 apart."""
    gpu_checks.correctness(config_of("device=cpu", "design=walker"), report, "correctness", [task], "float32")
    assert report.figures["correctness"][0]["pos"] < 6e-9


@pytest.mark.parametrize("wrong", [{"gravity": 110.1}, {"friction": 0.0}, {"drag": 0.11}])
def test_a_kernel_that_is_a_little_wrong_is_found(wrong: dict, report: Report, monkeypatch: pytest.MonkeyPatch) -> None:
    right = cases.make_vec

    def make(task: str, *words: Any, dtype: str, **options: Any) -> Any:
        physics = Physics.preset("evogym", **(wrong if dtype == "float32" else {}))
        return right(task, *words, dtype=dtype, physics=physics, **options)

    monkeypatch.setattr(cases, "make_vec", make)
    with pytest.raises(SimulationError, match="The device differs from the CPU in Walker-v0"):
        gpu_checks.correctness(
            config_of("device=cpu", "design=walker"), report, "correctness", ["Walker-v0"], "float32"
        )


def test_its_parts_run_on_a_device(report: Report, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a simulated one; in float64 the lanes compute, which it does not have, and training is tested elsewhere."""
    monkeypatch.setattr(gpu_checks, "STEPS", 6)
    monkeypatch.setattr(gpu_rates, "training", lambda *_: None)
    monkeypatch.setattr(gpu_rates, "learning", lambda *_: None)
    monkeypatch.setattr(gpu_checks, "recordings", lambda *_: None)
    monkeypatch.setattr(gpu_tools, "profile", lambda *_: None)
    with SimulatedCuda() as cuda:
        config = config_of("device=cuda:0", "tasks=[Walker-v0]", "design=mini")
        for name, part in gpu._parts(config, replace(gpu.SMALL, envs=(8,)), report).items():
            if name != "double":
                report.run(name, part)
    figures = report.figures
    assert figures["failed"] == figures["left_out"] == [], figures
    assert figures["smoke"]["layout"] == "group"
    assert figures["graph"]["num_envs"] == figures["stream"]["num_envs"] == 8
    assert figures["sizes"][0]["single"] > 0
    assert {"graph", "stream", "sizes"} <= figures["seconds"].keys()
    assert cuda.captured
    assert all(graph.replays for graph in cuda.captured)


def test_sizes_beyond_the_memory_are_left_out(report: Report, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "free_memory", lambda device: 10**6)
    gpu_rates.sizes(config_of("device=cpu", "design=mini"), report, (4096, 1))
    assert [row["num_envs"] for row in report.figures["sizes"]] == [1]
    assert "Left out: 4,096 environments need" in report.write()


@pytest.mark.skipif(os.name != "posix", reason="a script stands in for the tool")
@pytest.mark.parametrize("errors", [0, 3])
def test_a_sanitizer_that_is_there_is_used(errors: int, report: Report, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = report.folder
    tool = folder / "compute-sanitizer"
    tool.write_text(
        f'#!/bin/sh\necho "$@"\necho "========= ERROR SUMMARY: {errors} errors"\nexit {9 if errors else 0}\n'
    )
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", str(folder), prepend=os.pathsep)
    config = SimpleNamespace(device="cuda:0", task="Walker-v0")
    with pytest.raises(SimulationError, match="memcheck in Walker-v0, racecheck") if errors else nullcontext():
        gpu_tools.sanitizer(config, report)
    rows = report.figures["sanitizer"]
    assert [row["tool"] for row in rows] == 3 * list(gpu_tools.TOOLS)
    assert [row["task"] for row in rows[::4]] == ["Walker-v0", *gpu_tools.LARGE]
    assert {row["good"] for row in rows} == {not errors}
    said = folder / "racecheck_Walker-v0.txt"
    assert said.is_file() == bool(errors)
    sample = 'bench.sample {"task": "Walker-v0", "num_envs": 64, "device": "cuda:0"} 8 2'
    assert not errors or sample in said.read_text()


def test_the_time_ends_between_parts_and_within_one(report: Report, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(report_module.time, "perf_counter", lambda: now[0])

    def tasks() -> None:
        for name in report.in_time("tasks", ("one", "two", "three")):
            report.row("tasks", name, task=name)
            now[0] += 6.0

    monkeypatch.setattr(gpu, "_parts", lambda *_: {"tasks": tasks, "later": tasks})
    gpu.run(SimpleNamespace(device="cpu", seconds=10.0), report)
    assert [row["task"] for row in report.figures["tasks"]] == ["one", "two"]
    assert report.figures["left_out"] == ["tasks: three", "later"]
    assert report.figures["seconds"] == {"tasks": 12.0}
    assert "Left out, for the 10 s were over: tasks: three, later." in report.write()


def test_without_a_gpu_its_suite_says_so(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    warpvox("bench", "suite=gpu", fails="no CUDA device was found")
    assert not Path("outputs").exists()
