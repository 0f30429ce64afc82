"""``warpvox bench``: every suite at a tiny size, and that no time is printed of a wrong result."""

import json
import shutil
import sys
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest
from tiny import once

from warpvox.bench import check, gradients, kernels, machine, reference, runner
from warpvox.bench.cases import full_body
from warpvox.bench.runner import Runner
from warpvox.configs.bench import BenchConfig
from warpvox.envs import memory
from warpvox.errors import ConfigError, SimulationError
from warpvox.kernels.state import DATA
from warpvox.kernels.step import STAGES

TINY = "design=mini num_envs=8 steps=2 repeats=1 columns=[step]".split()
FIGURE_2 = "scaling.bodies=2 scaling.seconds=0.04".split()

# A package that looks like the reference to the worker, and is warpvox: the whole protocol runs without evogym.
FAKE = """
import gymnasium, numpy as np
from warpvox.envs.adapters.gym import VoxelEnv

class Env(VoxelEnv):
    def __init__(self, task, body, **rest):
        super().__init__(task, body.astype(int), **rest)
    def get_time(self):
        return 0
    def object_pos_at_time(self, time, name):
        return self.sim.object_positions(name)[0].double().numpy().T + OFFSET

gymnasium.register("Walker-v0", entry_point=Env, max_episode_steps=100, kwargs={"task": "Walker-v0"})
"""


@pytest.fixture
def fake_reference(tmp_path: Path) -> Callable[..., Path]:
    """Make an interpreter with a package ``evogym``, whose centre of mass is off by so much."""

    def make(offset: float = 0.0) -> Path:
        home = tmp_path / f"fake{offset}"
        (home / "evogym").mkdir(parents=True)
        (home / "evogym" / "__init__.py").touch()
        (home / "evogym" / "envs.py").write_text(f"OFFSET = {offset}\n{FAKE}")
        (home / "evogym-2.0.0.dist-info").mkdir()
        (home / "evogym-2.0.0.dist-info" / "METADATA").write_text(
            "Metadata-Version: 2.1\nName: evogym\nVersion: 2.0.0\n"
        )
        python = home / "python"
        # called as python -I worker.py: evogym must be found, but not what lies beside the worker
        command = f'cp "$2" {home}/worker.py; PYTHONPATH={home} exec {sys.executable} {home}/worker.py'
        python.write_text(f"#!/bin/sh\n{command}\n")
        python.chmod(0o755)
        return python

    return make


@pytest.fixture
def bench(warpvox: Callable) -> Callable[..., tuple[str, dict]]:
    """Run a suite; returns what it printed, on one line, and its figures."""

    def run(suite: str, *words: str) -> tuple[str, dict]:
        outcome = warpvox("bench", f"suite={suite}", *once(*TINY, *words))
        (folder,) = Path("outputs/bench").joinpath(suite).iterdir()
        assert (folder / "config.yaml").is_file()
        figures = json.loads((folder / "summary.json").read_text())
        tables = (folder / "tables.md").read_text()
        assert len(tables) > 100
        assert f"Machine: {figures['machine']['cores']} usable cores of {figures['machine']['cpu']}; Python" in tables
        return " ".join(outcome.out.split()), figures

    return run


def test_peer_compares_before_it_times(bench: Callable, fake_reference: Callable) -> None:
    said, figures = bench("peer", "columns=[step,inference,training]", f"peer={fake_reference()}")
    assert figures["check_error"] < check.TOLERANCE
    assert figures["versions"]["evogym"] == "2.0.0"
    (batch, *rates, ratio), alone, drop_in, theirs = figures["tables"][0]["rows"]
    assert batch == "warpvox, 8 environments"
    assert all(rate > 0 for repetitions in rates for rate in repetitions)
    assert ratio == pytest.approx(rates[0][0] / theirs[1][0])
    assert alone[1][0] > 0 < drop_in[1][0]
    assert theirs[2:] == [None, None, 1.0]
    assert {"cpu", "cores", "python", "torch", "warp", "warpvox"} <= set(figures["machine"])
    assert said.index("Checked: ") < said.index("step only")


def test_a_wrong_result_gets_no_time(warpvox: Callable, fake_reference: Callable) -> None:
    outcome = warpvox(
        "bench",
        "suite=peer",
        *TINY,
        f"peer={fake_reference(1e-5)}",
        fails="differs from the reference by 1.0e-05",
    )
    assert "steps per second" not in outcome.out
    assert not Path("outputs").exists()


def test_the_last_environment_is_compared_too(monkeypatch: pytest.MonkeyPatch) -> None:
    bodies = [full_body(3, seed) for seed in (0, 1)]
    make = check.make_vec
    monkeypatch.setattr(check, "make_vec", lambda spec, _, *rest, **options: make(spec, bodies[:1], *rest, **options))
    with pytest.raises(SimulationError, match="differs from one alone"):
        Runner(BenchConfig(device="cpu"), bodies, 8)


def test_tasks_with_and_without_the_reference(bench: Callable, fake_reference: Callable) -> None:
    said, figures = bench("tasks", "tasks=[Walker-v0]", f"peer={fake_reference()}")
    (row,) = figures["tables"][0]["rows"]
    assert figures["ratio_least"] == row[-1] == pytest.approx(row[1][0] / row[2][0])
    assert "Ratio: median" in said
    shutil.rmtree("outputs")
    said, figures = bench("tasks", "tasks=[Lifter-v0]")
    assert "there was no reference" in said
    ((task, (rate,), *rest),) = figures["tables"][0]["rows"]
    assert (task, rate > 0, rest) == ("Lifter-v0", True, [None, None])


def test_mixed_builds_times_and_exchanges_bodies(bench: Callable) -> None:
    said, figures = bench("mixed")
    assert [len(rates) for _, rates in figures["tables"][0]["rows"]] == [1] * 6
    assert figures["check_error"] < check.ROUNDING["float32"]
    assert figures["built"] > 0 < figures["changed"][0]
    assert "8 different bodies" in said


def test_gradients_are_checked_then_timed_then_used(bench: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in dict(BODIES=8, STEPS=12, ITERATIONS=2, SMOOTHINGS=[1e-3]).items():
        monkeypatch.setattr(gradients, name, value)
    said, figures = bench("gradients")
    assert figures["error"] < 0.05
    times, gaits = (table["rows"] for table in figures["tables"])
    assert [len(taken) for _, taken, _ in times] == [1, 1, 1]
    assert [row[0] for row in gaits] == ["gradients, smoothing 0.001", "best of 10 random waves"]
    assert all(low <= mean <= high for _, mean, low, high in gaits)
    assert "8 different bodies" in said


def test_wrong_derivatives_are_not_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gradients, "_error", lambda *_: float("nan"))
    config = SimpleNamespace(seed=0)
    report = SimpleNamespace(console=SimpleNamespace(status=lambda _: nullcontext()))
    with pytest.raises(SimulationError, match="differ by nan% from finite differences"):
        gradients.run(config, report)


@pytest.mark.slow
def test_scaling_in_three_ways(bench: Callable, fake_reference: Callable) -> None:
    words = [*FIGURE_2, "scaling.sizes=[2,3]", "scaling.envs=[1,8]", f"peer={fake_reference()}"]
    said, figures = bench("scaling", *words)
    for row, side in zip(figures["bodies"], (2, 3), strict=True):
        assert (row["side"], row["sampled"], row["steps"], row["num_envs"]) == (side, True, 2, 8)
        assert all(1 <= voxels <= side * side for voxels in row["voxels"])
        assert [len(row[name]) for name in ("voxels", "one", "reference")] == [2, 2, 2]
        assert row["ratio"] == pytest.approx(sum(row["one"]) / sum(row["reference"]))
        assert row["batch_ratio"] == pytest.approx(row["rates"][0] / row["reference"][0])
        assert row["reference_error"] < 1e-6
    _, envs, threads = (table["rows"] for table in figures["tables"])
    assert [row[0] for row in envs] == ["1", "8"]
    assert threads[0][2] == 1
    assert "means of 2 robots, one at a time, 0.04 simulated seconds each" in said


@pytest.mark.parametrize(
    ("envs", "limit", "left_out"), [([8, 4096], 4, "4,096 (memory"), ([8], 1e-9, "8 (over 1e-09 s a repetition)")]
)
def test_scaling_leaves_out_what_does_not_fit(envs: list[int], limit: float, left_out: str, bench, monkeypatch) -> None:
    monkeypatch.setattr(memory, "free_memory", lambda device: 10**7)
    said, figures = bench("scaling", *FIGURE_2, "scaling.sizes=[2]", f"scaling.envs={envs}", f"limit={limit}")
    assert left_out in said
    assert [row[0] for row in figures["tables"][1]["rows"]] == [str(count) for count in envs[:-1]]


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_kernels_names_every_stage(compiled: bool, bench: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    if not compiled:
        monkeypatch.setattr(kernels, "compile_seconds", lambda *_: None)
    _, figures = bench("kernels", "design=walker")
    stages, parts, sizes = (table["rows"] for table in figures["tables"])
    assert list(kernels.STAGES) == [build.__name__ for build in STAGES["fast"]]
    assert [row[0] for row in stages] == [*kernels.STAGES.values(), "all stages"]
    assert stages[-1][1] > 0
    assert sizes[-1][1] > 1
    assert {name for names in machine.GROUPS.values() for name in names} <= set(DATA)
    assert [name for name, _ in parts] == ["physics alone", "step only"]
    assert (figures["compile"] is not None) is compiled


def test_kernels_times_no_stages_of_a_group(bench: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels, "compile_seconds", lambda *_: None)
    monkeypatch.setattr(runner, "make", partial(runner.make, layout="group"))
    said, figures = bench("kernels", "design=walker")
    assert [table["title"].split(": ")[1].split(",")[0] for table in figures["tables"]] == ["parts", "memory"]
    assert "Stages" not in said


def test_a_document_gets_the_tables(bench: Callable) -> None:
    page = Path("page.md")
    page.write_text("before\n<!-- bench tasks -->\nold\n<!-- end -->\nafter\n")
    bench("tasks", "tasks=[Walker-v0]", f"document={page}")
    text = page.read_text()
    assert text.startswith("before\n<!-- bench tasks -->\n")
    assert text.endswith("<!-- end -->\nafter\n")
    assert "| step only |" in text
    assert "Machine: " in text
    assert "old" not in text


@pytest.mark.parametrize(("document", "words"), [("nowhere.md", "no file"), ("page.md", "no place for this suite")])
def test_a_document_without_a_place_is_said_before_anything_is_measured(warpvox, document: str, words: str) -> None:
    Path("page.md").write_text("<!-- bench tasks -->\n<!-- end -->\n")
    warpvox("bench", "suite=kernels", f"document={document}", *TINY, fails=words)
    assert not Path("outputs").exists()


def test_without_python_310_no_reference_is_made(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ConfigError, match=r"Python 3\.10"):
        reference.make_reference(tmp_path / "made")


@pytest.mark.parametrize("works", [True, False])
def test_the_reference_is_made_once_and_whole(works: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made, calls = tmp_path / "made", tmp_path / "calls"
    venv = f'if [ "$2" = venv ]; then mkdir -p {made}/bin; cp "$0" {made}/bin/python; fi'
    pip = "" if works else '; [ "$2" != pip ] || exit 3'
    base = tmp_path / "python3.10"
    base.write_text(f'#!/bin/sh\necho "$@" >> {calls}; {venv}{pip}\n')
    base.chmod(0o755)
    monkeypatch.setattr(reference.shutil, "which", lambda _: str(base))
    if not works:
        with pytest.raises(ConfigError, match="could not be installed"):
            reference.make_reference(made)
        assert not made.exists()
        return
    reference.make_reference(made)
    reference.make_reference(made)
    assert calls.read_text().count("-m venv") == 1
    assert reference.PACKAGE in calls.read_text()
