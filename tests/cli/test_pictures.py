"""Pictures that commands make: learning curves, the gallery of tasks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from warpvox.cli.curves import _curve, _mean
from warpvox.cli.gallery import COLUMNS, TILE, draw_gallery
from warpvox.cli.runs import Run
from warpvox.envs.registry import task_ids
from warpvox.errors import RunError
from warpvox.palette import LEVELS, palette
from warpvox.types import Cell

HEAD = "iteration,steps,eval_return,elapsed\n"


def make_run(folder: Path, rows: list[tuple[int, float | None]]) -> Run:
    folder.mkdir(parents=True)
    lines = [f"{k},{steps},{'' if value is None else value},{k}" for k, (steps, value) in enumerate(rows)]
    (folder / "metrics.csv").write_text(HEAD + "\n".join(lines) + "\n")
    (folder / "config.yaml").write_text("task: Walker-v0\ndesign: walker\nppo: {}\n")
    return Run(folder, {"task": "Walker-v0"})


def test_metrics_without_a_column_are_refused(tmp_path: Path) -> None:
    run = make_run(tmp_path / "a", [(10, 1.0)])
    table = run.folder / "metrics.csv"
    table.write_text(table.read_text().replace("elapsed", "lapsed"))
    with pytest.raises(RunError, match=r"metrics\.csv has no column elapsed; move it away"):
        _curve(run, "steps")


def test_curves_hold_the_evaluations(tmp_path: Path) -> None:
    found = make_run(tmp_path / "a", [(10, None), (20, 1.0), (30, None), (40, 3.0)])
    assert _curve(found, "steps").tolist() == [[20, 40], [1, 3]]
    other = np.array([[10.0, 60.0], [0.0, 5.0]])
    places, mean = _mean([_curve(found, "steps"), other])
    assert (places[0], places[-1]) == (20, 60)
    assert (mean[0], mean[-1]) == ((1 + 1) / 2, (3 + 5) / 2)  # the shorter one keeps its last value


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_curves_of_several_runs(warpvox: Callable, suffix: str) -> None:
    pytest.importorskip("matplotlib")
    for name, top in (("a", 3.0), ("b", 4.0)):
        make_run(Path(name), [(10, 0.0), (20, top)])
    words = ("curves", "runs=[a,b]", f"file=out/curves{suffix}", "size=[500,300]")
    assert warpvox(*words).code == 0
    first = Path(f"out/curves{suffix}").read_bytes()
    assert warpvox(*words).code == 0
    assert first == Path(f"out/curves{suffix}").read_bytes()  # no date, no chance
    if suffix == ".png":
        with Image.open(f"out/curves{suffix}") as picture:
            assert picture.size == (500, 300)


def test_curves_that_cannot_be_drawn(warpvox: Callable) -> None:
    make_run(Path("a"), [(10, None)])
    outcome = warpvox("curves", "runs=[a]")
    assert (outcome.code, "no evaluation yet" in outcome.err) == (2, True)
    outcome = warpvox("curves", "runs=[a]", "file=x.bmp")
    assert (outcome.code, "must end in .png" in outcome.err) == (2, True)
    assert not list(Path().glob("*.png"))


def test_the_gallery_shows_a_robot_in_every_task(warpvox: Callable) -> None:
    outcome = warpvox("tasks", "gallery=all.png", "design=mini")
    assert outcome.code == 0, outcome.err
    sheet = np.asarray(draw_gallery("mini"), int)
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
