"""The page of results is what its command makes of the committed table, and the table what the archives say."""

from __future__ import annotations

import importlib.util
import json
import re
from pathlib import Path
from typing import Any

import pytest

from warpvox.algos.candidate import Candidate, Outcome
from warpvox.algos.checkpoints.files import save_checkpoint
from warpvox.algos.codesign.archive import FILE, Archive, Finished
from warpvox.cli.config import load, to_yaml
from warpvox.cli.runs import END
from warpvox.design import sample_design
from warpvox.envs.known_returns import known_returns
from warpvox.robots import Gait, zoo, zoo_tasks

DOCS = Path(__file__).resolve().parents[2] / "docs"
SPEC = importlib.util.spec_from_file_location("results", DOCS / "results.py")
results = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(results)


def test_the_page_is_up_to_date() -> None:
    text = (DOCS / "results.md").read_text(encoding="utf-8")
    assert text == results.page(results.read_table()), "run `python docs/results.py`"
    reached, known = re.search(r"\*\*(\d+)\*\* of the (\d+) tasks", text).groups()
    assert f"On {reached} of {known} tasks" in (DOCS.parent / "README.md").read_text(encoding="utf-8")


def test_returns_below_the_best_published_ones_are_marked() -> None:
    best = known_returns()["Walker-v0"].best
    row = dict.fromkeys(results.COLUMNS, "") | {"task": "Walker-v0", "control_steps": "2000", "seconds": "7500"}
    lines = {}
    for name, values in {
        "above": {"return": str(best + 0.1), "evaluation": "0"},
        "below": {"return": str(best - 0.1), "evaluation": str(best + 1)},  # what is replayed counts
        "search": {"return": "", "evaluation": str(best)},
        "gait": {"return": str(best + 0.1), "policy": "gait"},
        "low gait": {"return": str(best - 0.1), "policy": "gait"},
    }.items():
        text = results.page([row | values])
        lines[name] = next(line for line in text.splitlines() if line.startswith("| Walker-v0 | ")).split(" | ")
    above, below = f"{best + 0.1:.3f}", f"{best - 0.1:.3f}"
    assert [cells[1] for cells in lines.values()] == [above, below, f"*{best:.3f}*", above, below]
    assert [cells[2] for cells in lines.values()] == ["", "▼", "", "○", "▼○"]
    assert lines["above"][-2:] == ["2,000", "2 h 05 min |"]
    assert "**0** of the 0 tasks with" in results.page([row | {"task": "Traverser-v0", "evaluation": "1"}])


def make_search(
    folder: Path, task: str, fitness: float, status: str = "done", policy: dict[str, Any] | None = None
) -> None:
    folder.mkdir(parents=True)
    config = load("codesign", [f"task={task}", "search.max_evaluations=30", "device=cpu"])
    (folder / "config.yaml").write_text(to_yaml(config) + END)
    (folder / "summary.json").write_text(json.dumps({"status": status, "elapsed_seconds": 61.4, "processor": "M7"}))
    with Archive.create(folder / FILE, {"task": task, "rules": "evogym", "seed": 0}) as archive:
        archive.propose([Candidate(0, sample_design((5, 7), 0))], 0)
        if policy is not None:
            save_checkpoint(folder / "model.pt", policy)
        archive.finish([Finished(0, Outcome(fitness, [], 500), policy and "model.pt")])


def test_the_table_keeps_the_best_of_searches_and_prefers_the_zoo(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (robot, *_) = zoo_tasks()
    monkeypatch.setattr(results, "zoo_tasks", lambda: [robot])
    gait = {"policy": {"gait": {"stages": 2}}, "actor_state_dict": {}}
    make_search(tmp_path / "a", "Lifter-v0", 1.25)
    make_search(tmp_path / "b", "Lifter-v0", 1.5, policy=gait)
    make_search(tmp_path / "c", "Lifter-v0", 9.0, "interrupted")
    make_search(tmp_path / "d", robot, 1e6)
    rows = {row["task"]: row for row in results.export([tmp_path])}
    found = rows["Lifter-v0"]
    assert (found["evaluation"], found["return"], found["shape"], found["policy"]) == ("1.5", "", "5x7", "gait")
    assert rows[robot]["policy"] == ("gait" if isinstance(zoo(robot).policy, Gait) else "")
    assert (found["control_steps"], found["seconds"], found["processor"]) == ("500", "61", "M7")
    assert found["command"] == "warpvox codesign task=Lifter-v0 search.max_evaluations=30"
    assert float(rows[robot]["return"]) == zoo(robot).mean_return
    assert rows[robot]["processor"] == zoo(robot).about["processor"]
    make_search(tmp_path / "later/e", "Lifter-v0", 1.375)
    path = tmp_path / "table.csv"
    results.write_table(path, results.export([tmp_path / "later"], list(rows.values())))
    assert {row["task"]: row for row in results.read_table(path)} == rows  # the worse one changes nothing
