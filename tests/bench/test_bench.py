"""``warpvox bench``: every suite at a tiny size, and that no time is printed of a wrong result."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from warpvox.bench import check, reference
from warpvox.bench.case import full_body, sampled_or_full
from warpvox.bench.report import number
from warpvox.configs.schema import ScalingConfig
from warpvox.design import check_design
from warpvox.errors import ConfigError, SimulationError, WarpvoxError

TINY = "design=mini num_envs=8 steps=2 repeats=1".split()

# A package that looks like the reference to the worker, and is warpvox: the whole protocol runs without evogym.
FAKE = """
import gymnasium, numpy as np
from warpvox.envs.gym import VoxelEnv

class Env(VoxelEnv):
    def __init__(self, task, body, **rest):
        super().__init__(task, body.astype(int), **rest)
    def get_time(self):
        return 0
    def object_pos_at_time(self, time, name):
        return self.sim.object_positions(name)[0].double().numpy().T + OFFSET

for task in ("Walker-v0", "UpStepper-v0"):
    gymnasium.register(task, entry_point=Env, max_episode_steps=100, kwargs={"task": task})
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
        python.write_text(f'#!/bin/sh\nshift\nPYTHONPATH={home} exec {sys.executable} "$@"\n')  # drops -I
        python.chmod(0o755)
        return python

    return make


def results(suite: str) -> tuple[Path, dict]:
    (folder,) = Path("outputs/bench").joinpath(suite).iterdir()
    assert (folder / "config.yaml").is_file()
    return folder, json.loads((folder / "summary.json").read_text())


def positive(rates: dict[str, list[float]]) -> bool:
    return all(value > 0 for values in rates.values() for value in values)


def test_step_has_three_columns(warpvox: Callable) -> None:
    outcome = warpvox("bench", "suite=step", *TINY)
    assert outcome.code == 0, outcome.err
    folder, figures = results("step")
    assert list(figures["rates"]) == ["step", "inference", "training"]
    assert positive(figures["rates"])
    for heading in ("step only", "with inference", "with training"):
        assert heading in outcome.out
        assert heading in (folder / "tables.md").read_text()
    assert {"cpu", "cores", "python", "torch", "warp", "warpvox"} <= set(figures["machine"])


def test_peer_compares_before_it_times(warpvox: Callable, fake_reference: Callable) -> None:
    outcome = warpvox("bench", "suite=peer", *TINY, f"peer.python={fake_reference()}")
    assert outcome.code == 0, outcome.err
    folder, figures = results("peer")
    assert figures["check_error"] < check.TOLERANCE
    assert figures["versions"]["evogym"] == "2.0.0"
    assert figures["ratio"]["step"] == pytest.approx(figures["rates"]["step"][0] / figures["reference"][0])
    pytest.importorskip("matplotlib", reason="plots need the extra view")
    assert (folder / "peer.png").stat().st_size > 1000


def test_a_wrong_result_gets_no_time(warpvox: Callable, fake_reference: Callable) -> None:
    outcome = warpvox("bench", "suite=peer", *TINY, f"peer.python={fake_reference(1e-5)}")
    assert outcome.code == 2
    assert "differs from the reference by 1.0e-05" in outcome.err
    assert "steps per second" not in outcome.out
    assert not Path("outputs").exists()


def test_a_wrong_batch_gets_no_time(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(check.ROUNDING, "float32", 1e-30)
    outcome = warpvox("bench", "suite=step", *TINY)
    assert outcome.code == 2
    assert "differs from one alone" in outcome.err


@pytest.mark.slow  # the protocol is that of suite=peer
def test_tasks_beside_the_reference(warpvox: Callable, fake_reference: Callable) -> None:
    words = ["tasks=[Walker-v0,UpStepper-v0]", "columns=[step]", f"peer.python={fake_reference()}"]
    outcome = warpvox("bench", "suite=tasks", *TINY, *words)
    assert outcome.code == 0, outcome.err
    _, figures = results("tasks")
    assert list(figures["tasks"]) == ["Walker-v0", "UpStepper-v0"]
    ratios = [row["ratio"] for row in figures["tasks"].values()]
    assert figures["ratio_least"] == min(ratios)
    assert "Ratio: median" in outcome.out


def test_tasks_alone(warpvox: Callable) -> None:
    outcome = warpvox("bench", "suite=tasks", "tasks=[Lifter-v0]", *TINY)
    assert outcome.code == 0, outcome.err
    assert "there was no reference" in outcome.out
    assert positive(results("tasks")[1]["tasks"]["Lifter-v0"]["rates"])


FIGURE_2 = "scaling.bodies=2 scaling.seconds=0.04".split()


def test_scaling_in_three_ways(warpvox: Callable, fake_reference: Callable) -> None:
    words = ["scaling.sizes=[2,3]", "scaling.envs=[1,8]", "columns=[step]", f"peer.python={fake_reference()}"]
    outcome = warpvox("bench", "suite=scaling", *TINY, *FIGURE_2, *words)
    assert outcome.code == 0, outcome.err
    folder, figures = results("scaling")
    for row, side in zip(figures["bodies"], (2, 3), strict=True):
        assert (row["side"], row["sampled"], row["steps"]) == (side, True, 2)
        assert all(1 <= voxels <= side * side for voxels in row["voxels"])
        assert [len(row[name]) for name in ("voxels", "one", "reference")] == [2, 2, 2]
        assert row["ratio"] == pytest.approx(sum(row["one"]) / sum(row["reference"]))
        assert row["batch_ratio"] == pytest.approx(row["rates"][0] / row["reference"][0])
        assert (row["num_envs"], row["reference_error"] < 1e-6) == (8, True)
    assert [row["num_envs"] for row in figures["envs"]] == [1, 8]
    assert figures["threads"]["rates"]
    assert "means of 2 robots, one at a time, 0.04 simulated seconds each" in " ".join(outcome.out.split())
    pytest.importorskip("matplotlib", reason="plots need the extra view")
    assert (folder / "figure2.png").stat().st_size > 1000


def test_a_quick_figure_2_has_fewer_sizes_robots_and_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    """And without any of that, the paper's protocol: n from 5 to 35, ten robots of each, ten seconds."""
    from warpvox.bench import figure2

    seen: list[tuple[int, int, float]] = []

    def one_size(config: object, scaling: ScalingConfig, side: int, reference: object) -> dict:
        seen.append((side, scaling.bodies, scaling.seconds))
        return {}

    monkeypatch.setattr(figure2, "_one_size", one_size)
    monkeypatch.setattr(figure2, "_show", lambda *_: None)
    report = SimpleNamespace(status=lambda _: nullcontext())
    for quick in (False, True):
        figure2.scale_bodies(SimpleNamespace(scaling=ScalingConfig(quick=quick)), report, None)
    assert seen[:31] == [(side, 10, 10.0) for side in range(5, 36)]
    assert seen[31:] == [(side, 3, 2.0) for side in range(5, 36, 5)]


def test_bodies_are_sampled_where_they_can_be_and_full_beyond() -> None:
    for side, expected in ((5, True), (12, True), (35, False)):
        bodies, sampled = sampled_or_full(side, 3, 0)
        assert sampled is expected
        assert len({body.tobytes() for body in bodies}) == 3
        for body in bodies:
            check_design(body)
            assert (body > 0).all() != sampled
        assert np.array_equal(sampled_or_full(side, 3, 0)[0], bodies)


def test_scaling_leaves_out_what_does_not_fit(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    from warpvox.bench import scaling

    monkeypatch.setattr(scaling, "available_memory", lambda device: 50_000.0)
    words = [*FIGURE_2, "scaling.sizes=[2]", "scaling.envs=[1,8,4096]", "columns=[step]"]
    outcome = warpvox("bench", "suite=scaling", *TINY, *words)
    assert outcome.code == 0, outcome.err
    assert "4,096 (memory" in outcome.out.replace("\n", " ")
    assert [row["num_envs"] for row in results("scaling")[1]["envs"]][-1] < 4096


def test_scaling_leaves_out_what_takes_too_long(warpvox: Callable) -> None:
    words = [*FIGURE_2, "scaling.sizes=[2]", "scaling.envs=[8]", "columns=[step]", "limit=1e-9"]
    outcome = warpvox("bench", "suite=scaling", *TINY, *words)
    assert outcome.code == 0, outcome.err
    assert "8 (over 1e-09 s a repetition)" in outcome.out.replace("\n", " ")


def test_learning_has_a_curve(warpvox: Callable) -> None:
    words = "learning.ppo=[parallel] learning.seeds=1 learning.stop_return=-100".split()
    outcome = warpvox("bench", "suite=learning", *TINY, *words)
    assert outcome.code == 0, outcome.err
    found = results("learning")[1]["ppo"]["parallel"]
    assert found["reached"] == 1
    (run,) = found["runs"]
    assert run["curve"][-1]["steps"] == run["steps"] > 0
    assert run["best_return"] >= run["curve"][-1]["return"] > -100


def test_kernels_names_every_stage(warpvox: Callable) -> None:
    from warpvox.kernels.step import STAGES

    outcome = warpvox(*"bench suite=kernels compile=false num_envs=256 steps=2 repeats=1".split())
    assert outcome.code == 0, outcome.err
    _, figures = results("kernels")
    assert list(figures["stages"]) == [build.__name__ for build in STAGES["fast"]]
    assert sum(figures["stages"].values()) > 0
    assert sum(figures["bytes"].values()) > 1000


@pytest.mark.slow
def test_kernels_compiles_anew(warpvox: Callable) -> None:
    outcome = warpvox("bench", "suite=kernels", *TINY)
    assert outcome.code == 0, outcome.err
    assert results("kernels")[1]["compile"].keys() == {"first", "cached"}


def test_a_document_gets_the_tables(warpvox: Callable) -> None:
    page = Path("page.md")
    page.write_text("before\n<!-- bench step -->\nold\n<!-- end -->\nafter\n")
    assert warpvox("bench", "suite=step", "columns=[step]", f"document={page}", *TINY).code == 0
    text = page.read_text()
    assert text.startswith("before\n<!-- bench step -->\nChecked: ")
    assert "| step only |" in text
    assert text.endswith("<!-- end -->\nafter\n")
    assert "old" not in text
    assert "Machine: " in text


@pytest.mark.parametrize(("document", "words"), [("nowhere.md", "no file"), ("page.md", "no place for this suite")])
def test_a_document_without_a_place_is_said_before_anything_is_measured(
    warpvox: Callable, document: str, words: str
) -> None:
    Path("page.md").write_text("<!-- bench step -->\n<!-- end -->\n")
    outcome = warpvox("bench", "suite=kernels", f"document={document}", *TINY)
    assert outcome.code == 2
    assert words in outcome.err
    assert not Path("outputs").exists()


# ------------------------------------------------------------------------------------- making the reference


def test_no_python_310_is_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(reference, "_candidates", lambda: iter([tmp_path / "missing"]))
    with pytest.raises(ConfigError, match=r"Python 3\.10"):
        reference.make_reference(tmp_path / "made")


def interpreter(folder: Path, body: str) -> Path:
    path = folder / "python3.10"
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(0o755)
    return path


def test_another_version_is_not_taken(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    wrong, right = tmp_path / "a", tmp_path / "b"
    wrong.mkdir(), right.mkdir()
    order = [interpreter(wrong, "exit 1"), interpreter(right, "exit 0")]
    monkeypatch.setattr(reference, "_candidates", lambda: iter(order))
    assert reference.find_python310() == order[1]


def test_half_an_installation_is_removed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made = tmp_path / "made"
    body = f'if [ "$2" = venv ]; then mkdir -p {made}/bin; cp "$0" {made}/bin/python; fi; [ "$2" != pip ] || exit 3'
    base = interpreter(tmp_path, body)
    monkeypatch.setattr(reference, "find_python310", lambda: base)
    with pytest.raises(ConfigError, match="could not be installed"):
        reference.make_reference(made)
    assert not made.exists()


def test_the_reference_is_made_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made = tmp_path / "made"
    body = f'echo "$@" >> {tmp_path}/calls; if [ "$2" = venv ]; then mkdir -p {made}/bin; cp "$0" {made}/bin/python; fi'
    base = interpreter(tmp_path, body)
    monkeypatch.setattr(reference, "find_python310", lambda: base)
    assert reference.make_reference(made) == reference.make_reference(made) == made / "bin" / "python"
    calls = (tmp_path / "calls").read_text()
    assert calls.count("-m venv") == 1
    assert reference.PACKAGE in calls


# --------------------------------------------------------------------------------------------- small parts


@pytest.mark.parametrize("side", [2, 5, 35])
def test_full_bodies_are_full_and_valid(side: int) -> None:
    body = full_body(side, 0)
    assert (body > 0).all()
    check_design(body)
    assert (full_body(side, 0) == body).all()
    assert side == 2 or (full_body(side, 1) != body).any()


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "-"),
        (float("nan"), "-"),
        (12345.6, "12,346"),
        (78.83, "78.8"),
        (0.0456, "0.046"),
        (2e-9, "2.0e-09"),
        (0, "0.000"),
    ],
)
def test_figures_keep_what_matters(value: float | None, text: str) -> None:
    assert number(value) == text


# ----------------------------------------------------------------------------------------------------- gpu


@pytest.mark.slow  # tests/kernels/test_limits.py holds the figures
def test_the_cuda_suite_predicts_from_instructions(warpvox: Callable) -> None:
    from warpvox.bench.ptxas import find_program

    try:
        find_program("nvdisasm")
    except WarpvoxError as missing:
        pytest.skip(str(missing))
    outcome = warpvox("bench", "suite=cuda", *TINY)
    assert outcome.code == 0, outcome.err
    folder, figures = results("cuda")
    assert [row["spilled"] for row in figures["limits"]] == [0, 0, 0, 0]
    assert all(low <= high for low, high in figures["predicted"].values())
    assert "warp instructions" in (folder / "tables.md").read_text()
    outcome = warpvox("bench", "suite=cuda", "task=Traverser-v0", *TINY)
    assert outcome.code == 2
    assert "smaller world" in outcome.err


GPU = "bench suite=gpu device=cpu design=mini repeats=1 steps=2 columns=[step] compile=false".split()


CHECKS = ["correctness", "determinism", "independence", "graph"]
SPEEDS = ["sizes", "stages", "bodies", "training", "learning"]
LONG = ["double", "other tasks", "tasks", "recordings", "other tasks, double", "compilation"]


def test_the_gpu_suite_runs_on_the_cpu(warpvox: Callable) -> None:
    outcome = warpvox(*GPU, "tasks=[Walker-v0,Lifter-v0]", "learning.stop_return=-100")
    assert outcome.code == 0, outcome.err
    _, figures = results("gpu")
    assert figures["failed"] == figures["left_out"] == []
    assert list(figures["seconds"]) == CHECKS + SPEEDS + LONG
    assert {row["task"] for row in figures["tasks"]} == {"Walker-v0", "Lifter-v0"}
    assert [figures[part][0]["task"] for part in ("correctness", "other tasks")] == ["Walker-v0", "Lifter-v0"]
    assert [row["num_envs"] for row in figures["sizes"]] == [1, 8]
    assert all(row["physics"]["block 64"] > 0 < row["step"] for row in figures["sizes"])
    assert figures["bodies"][0]["different"] > 0
    assert [row["num_envs"] for row in figures["training"][:-1]] == [8]
    assert figures["training"][0]["operations"] > 1000 < figures["training"][0]["training"]
    assert figures["training"][-1].keys() == {"designs", "envs", "rate"}
    assert "equal bit for bit" in outcome.out


def test_what_was_found_is_kept_when_the_call_is_cut_off(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    from warpvox.bench import gpu_rates, progress

    saved = []
    write = progress.write_summary
    monkeypatch.setattr(progress, "write_summary", lambda folder, content: (saved.append(1), write(folder, content)))

    def cut_off(subject: object, config: object) -> None:
        assert len(saved) >= 6, "each row is saved by itself"
        raise KeyboardInterrupt

    monkeypatch.setattr(gpu_rates, "stage_times", cut_off)
    assert warpvox(*GPU, "tasks=[Walker-v0]").code == 130
    folder, figures = results("gpu")
    assert list(figures["seconds"]) == [*CHECKS, "sizes", "stages"]
    assert figures["correctness"][0]["good"] is True
    assert len(figures["sizes"]) == 2
    assert figures["machine"]["warp"]
    tables = (folder / "tables.md").read_text()
    assert "predicted for 16 threads an environment" in tables
    assert "equal bit for bit" in tables


def test_predictions_stand_beside_what_was_predicted_for(warpvox: Callable) -> None:
    from warpvox.bench.predictions import PREDICTED, predicted

    assert predicted("Walker-v0", "float32", 16384) == "3.60 to 7.30 M"
    one = "one thread an environment"
    assert predicted("Walker-v0", "float32", 16384, one) == "0.600 to 0.900 M"
    assert {predicted("Walker-v0", "float64", 16384), predicted("Climber-v0", "float32", 16384)} == {"-"}
    assert {predicted("Walker-v0", "float32", 8), predicted("Walker-v0", "float32", 16384, "another kernel")} == {"-"}
    assert all(low < high for of_kernel in PREDICTED.values() for low, high in of_kernel.values())


def test_the_time_ends_within_a_part_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import io

    from rich.console import Console

    from warpvox.bench import progress as module
    from warpvox.bench.report import Report

    now = [0.0]
    monkeypatch.setattr(module.time, "perf_counter", lambda: now[0])
    shown = io.StringIO()
    progress = module.Progress(Report(Console(file=shown), tmp_path), {}, seconds=10.0)
    with progress.part("tasks"):
        for name in ("one", "two", "three"):
            if progress.time_for(f"tasks: {name}"):
                progress.row("tasks", name, task=name)
            now[0] += 6.0
    figures = progress.close()
    assert [row["task"] for row in figures["tasks"]] == ["one", "two"]
    assert figures["left_out"] == ["tasks: three"]
    assert figures["seconds"] == {"tasks": 18.0}
    assert "Left out, for the 10 s were over: tasks: three." in shown.getvalue()


def test_without_a_gpu_its_suite_says_so(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    outcome = warpvox("bench", "suite=gpu")
    assert outcome.code == 2
    assert "no CUDA device was found" in outcome.err
    assert not Path("outputs").exists()


def test_no_part_begins_when_the_time_is_over(warpvox: Callable) -> None:
    outcome = warpvox(*GPU, "tasks=[Walker-v0]", "seconds=1e-6")
    assert outcome.code == 0, outcome.err
    assert len(results("gpu")[1]["left_out"]) == 13
    assert "Left out, for the 1e-06 s were over: correctness, determinism" in outcome.out.replace("\n", " ")


def test_a_part_that_fails_does_not_stop_the_others(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    from warpvox.bench import gpu, gpu_rates

    monkeypatch.setattr(gpu.gpu_checks, "POSITION", {"float64": 1e-9, "float32": 1e-30})
    for part in ("sizes", "stages", "bodies", "training", "learning", "tasks"):
        monkeypatch.setattr(gpu_rates, part, lambda *_: None)
    outcome = warpvox(*GPU, "tasks=[Walker-v0]")
    assert outcome.code == 2
    assert "These parts failed: correctness" in outcome.err
    _, figures = results("gpu")
    assert figures["failed"] == ["correctness"]
    assert figures["correctness"][0]["good"] is False
    assert figures["determinism"]["steps"] > 0


@pytest.mark.parametrize("offset", [0, 1])
def test_equal_bit_for_bit_is_tested(offset: int) -> None:
    import torch

    from warpvox.bench.gpu_checks import _compare

    one = {"pos": torch.zeros(3, dtype=torch.float64)}
    other = {"pos": torch.full((3,), offset * 1e-300, dtype=torch.float64)}
    if offset:
        with pytest.raises(SimulationError, match="differ in pos"):
            _compare(one, other, "Runs")
    else:
        _compare(one, other, "Runs")


@pytest.mark.parametrize(("code", "failed"), [(0, False), (1, True)])
def test_the_gpu_check_runs_the_tests_of_this_checkout(
    code: int, failed: bool, tmp_path: Path, repository: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rich.console import Console

    from warpvox.bench import gpu_checks
    from warpvox.bench.report import Report

    words: list[str] = []

    def tests(command: list[str], **_: object) -> SimpleNamespace:
        words.extend(command)
        return SimpleNamespace(stdout="2 passed\n", returncode=code)

    monkeypatch.setattr(gpu_checks.subprocess, "run", tests)
    report = Report(Console(quiet=True), tmp_path)
    with pytest.raises(SimulationError, match="2 passed") if failed else nullcontext():
        found = gpu_checks.recordings(SimpleNamespace(device="cuda:0"), report, seconds=60.0)
        assert found == {"replayed": True, "result": "2 passed"}
    assert words[-1] == str(repository / "tests")
