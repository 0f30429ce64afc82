"""``warpvox curves``; the gallery of all tasks."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from warpvox.algos.archive import FILE, Archive, Finished
from warpvox.algos.candidate import Candidate, Outcome
from warpvox.algos.report.gallery import COLUMNS, TILE, draw_gallery, everywhere
from warpvox.algos.report.learning_curves import curves_of
from warpvox.algos.statistics import mean_interval
from warpvox.cli.run_groups import group_runs
from warpvox.design import sample_design
from warpvox.envs.registry import task_ids
from warpvox.errors import RunError
from warpvox.palette import LEVELS, palette
from warpvox.runs import Run
from warpvox.types import Cell

HEAD = "iteration,steps,eval_return,elapsed\n"


def make_run(folder: Path, rows: list[tuple[int, float | None]]) -> Run:
    folder.mkdir(parents=True)
    lines = [f"{k},{steps},{'' if value is None else value},{k}" for k, (steps, value) in enumerate(rows)]
    (folder / "metrics.csv").write_text(HEAD + "\n".join(lines) + "\n")
    (folder / "config.yaml").write_text("task: Walker-v0\ndesign: walker\nppo: {}\n...\n")
    return Run(folder, {"task": "Walker-v0"})


def test_metrics_without_a_column_are_refused(tmp_path: Path) -> None:
    run = make_run(tmp_path / "a", [(10, 1.0)])
    table = run.folder / "metrics.csv"
    table.write_text(table.read_text().replace("elapsed", "lapsed"))
    with pytest.raises(RunError):
        curves_of(group_runs([run]))


def test_curves_hold_the_evaluations_and_their_interval(tmp_path: Path) -> None:
    first = make_run(tmp_path / "a", [(10, None), (20, 1.0), (30, None), (40, 3.0)])
    second = make_run(tmp_path / "b", [(10, 0.0), (60, 5.0)])
    (alone,) = curves_of(group_runs([first]))
    assert alone.runs[0].tolist() == [[20, 40], [1, 3]]
    assert (len(alone.runs), alone.mean.tolist(), np.isnan(alone.low).all()) == (1, [1, 3], True)
    (curve,) = curves_of(group_runs([first, second]))
    assert (curve.places[0], curve.places[-1], len(curve.runs)) == (20, 60, 2)
    assert (curve.mean[0], curve.mean[-1]) == ((1 + 1) / 2, (3 + 5) / 2)  # the shorter one keeps its last value
    interval = mean_interval([3, 5])
    assert (curve.low[-1], curve.high[-1]) == pytest.approx((interval.low, interval.high))


def test_runs_with_other_settings_have_a_curve_of_their_own(warpvox: Callable) -> None:
    pytest.importorskip("matplotlib")
    for number, gamma in enumerate((0.9, 0.9, 0.99)):
        run = make_run(Path(f"runs/{number}"), [(10, 0.0), (20, 1.0 + number)])
        text = f"task: Walker-v0\ndesign: walker\nseed: {number}\nppo:\n  gamma: {gamma}\n"
        (run.folder / "config.yaml").write_text(f"{text}...\n")
    make_run(Path("runs/young"), [(10, None)])
    Path("runs/0/model_1.pt").touch()  # of one run, and no other
    outcome = warpvox("curves", "runs=[runs/*,runs/0/model_1.pt]", "file=c.svg")
    with Path("c.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    ends = {row["settings"]: row for row in rows}
    assert [(name, row["n"], float(row["mean"])) for name, row in ends.items()] == [
        ("ppo.gamma=0.9", "2", 1.5),
        ("ppo.gamma=0.99", "1", 3.0),
    ]
    expected = mean_interval([1.0, 2.0])
    assert float(ends["ppo.gamma=0.9"]["low"]) == pytest.approx(expected.low)
    assert ends["ppo.gamma=0.99"]["low"] == ""
    assert "1.500 [" in outcome.out
    assert "without an evaluation yet: young" in outcome.out


def test_runs_of_several_tasks_have_a_panel_for_each(warpvox: Callable) -> None:
    pytest.importorskip("matplotlib")
    for task, seed in (("Walker-v0", 1), ("Walker-v0", 2), ("Carrier-v0", 1), ("Carrier-v0", 2), ("Carrier-v0", 3)):
        run = make_run(Path(f"out/train/{task}/{seed}"), [(10, 0.0), (20, 1.0 + seed)])
        (run.folder / "config.yaml").write_text(f"task: {task}\ndesign: walker\nseed: {seed}\nppo: {{}}\n...\n")
    warpvox("curves", "runs=out/train/*/*", "size=[300,200]")
    with Image.open("curves.png") as picture:
        assert picture.size == (600, 200)
    with Path("curves.csv").open(encoding="utf-8", newline="") as file:
        ends = {row["settings"]: (row["n"], row["mean"]) for row in csv.DictReader(file)}
    assert ends == {"Walker-v0": ("2", "2.5"), "Carrier-v0": ("3", "3")}


@pytest.mark.parametrize("runs", ["latest", "[latest]", "a", "[a,a]"])
def test_one_run_by_any_name(runs: str, warpvox: Callable) -> None:
    pytest.importorskip("matplotlib")
    run = make_run(Path("outputs/train/Walker-v0/2026-01-01_00-00-00"), [(10, 0.0)])
    (run.folder / "model_1.pt").touch()
    make_run(Path("a"), [(10, 0.0)])
    warpvox("curves", f"runs={runs}")
    assert len(Path("curves.csv").read_text().splitlines()) == 2


def test_curves_that_cannot_be_drawn(warpvox: Callable) -> None:
    make_run(Path("a"), [(10, None)])
    warpvox("curves", "runs=[a]", fails="no evaluation yet")
    warpvox("curves", "runs=[a]", "file=x.bmp", fails="must end in .png")
    assert not list(Path().glob("*.png"))


@pytest.mark.slow
def test_the_gallery_shows_a_robot_in_every_task(warpvox: Callable) -> None:
    warpvox("tasks", "gallery=all.png", "design=mini")
    sheet = np.asarray(draw_gallery(everywhere("mini")), int)
    with Image.open("all.png") as written:
        assert np.abs(np.asarray(written.convert("RGB"), int) - sheet).mean() < 2
    rows = -(-len(task_ids()) // COLUMNS)
    high, wide = sheet.shape[0] // rows, sheet.shape[1] // COLUMNS
    for number in range(len(task_ids())):
        row, column = divmod(number, COLUMNS)
        tile = sheet[row * high : (row + 1) * high, column * wide : column * wide + TILE[0]]
        for cell in (Cell.H_ACT, Cell.V_ACT):  # at rest
            colour = palette()[LEVELS * (cell - 1) + LEVELS // 2].astype(int)
            assert (np.abs(tile - colour).max(axis=-1) < 4).sum() > 60, task_ids()[number]


def make_searches(root: Path) -> None:
    for task in ("Walker-v0", "Carrier-v0"):
        for seed in range(2):
            folder = root / task / "ga" / f"seed{seed}"
            folder.mkdir(parents=True)
            with Archive.create(folder / FILE, {"task": task, "seed": seed, "search": {"algorithm": "ga"}}) as archive:
                bodies = [sample_design((3, 3), 10 * seed + k) for k in range(2)]
                archive.propose([Candidate(k, body) for k, body in enumerate(bodies)], seed)
                archive.finish([Finished(k, Outcome(seed + 2.0 * k, [(5, 1.0)], 100)) for k in range(2)])


def test_curves_of_design_searches_have_a_panel_for_each_task(warpvox: Callable) -> None:
    pytest.importorskip("matplotlib")
    make_searches(Path("several"))
    warpvox("curves", "runs=[several]", "x=evaluations", "size=[300,200]")
    with Image.open("curves.png") as picture:
        assert picture.size == (600, 200)
    with Path("curves.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    expected = mean_interval([2.0, 3.0])
    for task in ("Walker-v0", "Carrier-v0"):
        own = [row for row in rows if row["settings"] == f"{task}, ga"]
        assert [(row["evaluations"], row["n"], float(row["mean"])) for row in own] == [("1", "2", 0.5), ("2", "2", 2.5)]
        assert float(own[-1]["low"]) == pytest.approx(expected.low)
    warpvox("curves", "runs='several/*/*/seed1'", "file=one.svg")
    assert len(Path("one.csv").read_text().splitlines()) == 1 + 2 * 2
    says = "x of design searches must be one of steps, evaluations"
    warpvox("curves", "runs=[several]", "x=elapsed", fails=says)
    make_run(Path("a"), [(10, 0.0)])
    warpvox("curves", "runs=[a,several]", fails="a is none and has none in it")
    warpvox("curves", "runs=[a]", "x=evaluations", fails="x of trainings")
