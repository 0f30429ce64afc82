"""The page of results is what its command makes of the committed table, and the table what the archives say."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
import results

from warpvox.algos.candidate import Candidate, Outcome
from warpvox.algos.checkpoints.files import save_checkpoint
from warpvox.algos.codesign.archive import FILE, Archive, Finished
from warpvox.cli.config import load
from warpvox.design import sample_design
from warpvox.envs.registry import known_returns
from warpvox.io.writing import to_yaml
from warpvox.robots import Gait, zoo, zoo_tasks
from warpvox.runs import END

DOCS = Path(__file__).resolve().parents[2] / "docs"
ROW = dict.fromkeys(results.COLUMNS, "") | {"task": "Walker-v0", "evaluation": "1", "command": "warpvox codesign"}
ROW |= {"control_steps": "2000", "seconds": "7500"}


def test_the_page_is_up_to_date_and_readme_says_what_it_says() -> None:
    text = (DOCS / "results.md").read_text(encoding="utf-8")
    rows, disturbed, repeated = map(results.read_table, (results.TABLE, results.DISTURBED, results.REPEATED))
    assert text == results.page(rows, disturbed, repeated), "run `python docs/results.py`"
    readme = " ".join((DOCS.parent / "README.md").read_text(encoding="utf-8").split())
    summary = " ".join(results.summary(rows, disturbed).split())
    assert summary in readme
    held = re.search(r"\d+ of \d+ robots are at or above the best published return", summary)[0]
    assert held in (DOCS / "index.md").read_text(encoding="utf-8")


def test_the_table_of_protocols_is_about_the_robots_of_the_zoo() -> None:
    rows = results.read_table(results.DISTURBED)
    means = {row["task"]: float(row["mean"]) for row in rows if row["episodes"] == "noise"}
    assert means == {task: pytest.approx(zoo(task).robust_return, abs=5e-4) for task in zoo_tasks()}
    with_sensors = {row["task"] for row in rows if row["episodes"] == "sensors"}
    assert with_sensors == {task for task in zoo_tasks() if not isinstance(zoo(task).policy, Gait)}


def test_a_mean_under_noise_counts_where_it_reaches_the_published_return() -> None:
    best = known_returns()["Walker-v0"].best
    for mean, held, shown in (best, 1, f"**{best:.3f}** ± 0.250"), (best - 0.5, 0, f"{best - 0.5:.3f} ± 0.250"):
        row = {"task": "Walker-v0", "episodes": "noise", "mean": str(mean), "high": str(mean + 0.25)}
        disturbed = [row | {"processor": "M7"}]
        assert f"every action, {held} of 1 robots are" in " ".join(results.summary([ROW], disturbed).split())
        assert f"| {shown} |" in results.page([ROW], disturbed)


def test_the_mean_of_five_trainings_leaves_the_best_and_the_worst_out() -> None:
    disturbed = [{"task": "Walker-v0", "episodes": "noise", "mean": "9", "high": "9.5", "processor": "M7"}]
    repeated = [{"task": "Walker-v0", "noise": str(value)} for value in (9.0, 1.0, 4.0, -50.0, 2.5)]
    assert "| 2.500 |" in results.page([ROW], disturbed, repeated)
    assert "| 2.500 |" not in results.page([ROW], disturbed, repeated[:-1])


def test_the_zoo_has_the_best_of_the_repeated_trainings() -> None:
    repeated: dict[str, dict[str, float]] = {}
    for row in results.read_table(results.REPEATED):
        repeated.setdefault(row["task"], {})[row["seed"]] = float(row["noise"])
    for task, means in repeated.items():
        assert len(means) <= results.RUNS
        assert max(means.values()) == pytest.approx(zoo(task).robust_return, rel=1e-5), task


def test_returns_below_the_best_published_ones_are_marked() -> None:
    best = known_returns()["Walker-v0"].best
    lines = {}
    for name, values in {
        "above": {"return": str(best + 0.1), "evaluation": "0"},
        "below": {"return": str(best - 0.1), "evaluation": str(best + 1)},  # what is replayed counts
        "search": {"return": "", "evaluation": str(best)},
        "gait": {"return": str(best + 0.1), "policy": "gait"},
        "low gait": {"return": str(best - 0.1), "policy": "gait"},
    }.items():
        text = results.page([ROW | values])
        lines[name] = next(line for line in text.splitlines() if line.startswith("| Walker-v0 | ")).split(" | ")
    above, below = f"{best + 0.1:.3f}", f"{best - 0.1:.3f}"
    assert [cells[1] for cells in lines.values()] == ["", "", "", "○", "○"]
    assert [cells[6] for cells in lines.values()] == [above, f"{below}▼", f"*{best:.3f}*", above, f"{below}▼"]
    assert lines["above"][-2:] == ["2,000", "2 h 05 min |"]
    assert "every action, 0 of 0 robots are" in results.page([ROW | {"task": "Traverser-v0", "evaluation": "1"}])


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


def test_the_table_keeps_the_best_of_searches_and_prefers_the_zoo(tmp_path: Path, monkeypatch) -> None:
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
    assert [rows[robot][name] for name in ("processor", "commit")] == [
        zoo(robot).about[name] for name in ("processor", "commit")
    ]
    make_search(tmp_path / "later/e", "Lifter-v0", 1.375)
    path = tmp_path / "table.csv"
    results.write_table(path, results.export([tmp_path / "later"], list(rows.values())))
    assert {row["task"]: row for row in results.read_table(path)} == rows  # the worse one changes nothing
