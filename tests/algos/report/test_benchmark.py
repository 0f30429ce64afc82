"""The report of several searches: it says what the archives say, is whole by itself, and equal for equal archives."""

import csv
import itertools
import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from warpvox.algos.candidate import Candidate, Outcome
from warpvox.algos.codesign.archive import FILE, Archive, Finished, archives_in
from warpvox.algos.report.benchmark import write_benchmark
from warpvox.algos.report.comparison import compare
from warpvox.algos.report.members import progress, read_members
from warpvox.design import sample_design
from warpvox.envs.registry import known_returns, task_ids

POPULATION = 3


def make_search(folder: Path, task: str, seed: int, fitness: list[float], steps: int = 100, **search: object) -> Path:
    """An archive with these returns, in generations of three; every design takes ``steps``."""
    folder.mkdir(parents=True)
    settings = {"task": task, "seed": seed, "search": {"algorithm": "ga"} | search}
    with Archive.create(folder / FILE, settings) as archive:
        for start in range(0, len(fitness), POPULATION):
            ids = range(start, min(start + POPULATION, len(fitness)))
            bodies = [sample_design((5, 5), 1000 * seed + k) for k in ids]
            waiting = [Candidate(k, b, (), "random", start // POPULATION) for k, b in zip(ids, bodies, strict=True)]
            archive.propose(waiting, seed)
            archive.finish([Finished(k, Outcome(fitness[k], [(steps, fitness[k])], steps)) for k in ids])
    return folder


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two searches on three tasks, of one of which no return is published; two seeds."""
    root = tmp_path_factory.mktemp("suite")
    for task, base in (("Catcher-v0", -1.0), ("Walker-v0", 4.0), ("Traverser-v0", 0.0)):
        for number, search in enumerate(("slow", "quick<")):
            for seed in range(2):
                fitness = [base + number + seed + k / 10 for k in range(7)]
                folder = root / "members" / task / search / f"seed{seed}"
                make_search(folder, task, seed, fitness, 100 * (1 + number))
    fresh = {"mean": 0.25, "low": 0.125, "high": 0.375, "episodes": 64}
    summary = {"elapsed_seconds": 90.0, "fresh_seeds": fresh}
    (root / "members/Catcher-v0/slow/seed1/summary.json").write_text(json.dumps(summary))
    return root


def test_the_page_says_what_the_archives_say(suite: Path, tmp_path: Path) -> None:
    page = write_benchmark(tmp_path, archives_in(suite), {"status": "a < b"}).read_text()
    assert "status</dt><dd>a &lt; b" in page
    assert "quick&lt;" in page
    rows = re.findall(r"<tr><td>(.*?)</td></tr>", page.partition('id="all"')[2].partition("</table>")[0])
    cells = [re.sub(r"<td[^>]*>", "", row).split("</td>") for row in rows]
    assert [row[0] for row in cells] == [t for t in ("Walker-v0", "Catcher-v0", "Traverser-v0") for _ in range(2)]
    slow = cells[2 * 1 + [row[1] for row in cells[2:4]].index("slow")]
    # returns of the two runs end at -1 + 0.6 and 0 + 0.6
    assert slow[2:] == ["2", "<b>0.600</b>", "0.100 ± 0.707", "0.250 [0.125, 0.375]", "0.333", "14", "1,400", "2 min"]
    assert not re.search(r"https?:|@import|url\(|<link[^>]*href=.(?!data:,)", page)
    with (tmp_path / "results.csv").open(encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    assert len(table) == 12
    assert [row["fresh_mean"] for row in table if row["fresh_mean"]] == ["0.25"]
    first = [sample_design((5, 5), k) for k in range(POPULATION)]  # of seed 0
    apart = [np.mean(one != other) for one, other in itertools.combinations(first, 2)]
    row = next(row for row in table if row["seed"] == "0")
    assert float(row["diversity_first"]) == pytest.approx(np.mean(apart))
    for name in ("evaluations.svg", "steps.svg", "comparison.svg"):
        text = (tmp_path / name).read_text()
        assert "var(" not in text
        panels = [node for node in ET.fromstring(text) if node.tag.endswith("}svg")]
        assert len(panels) == (4 if name == "comparison.svg" else 3)
    assert {path.stem for path in (tmp_path / "generations").iterdir()} == {"Walker-v0", "Catcher-v0", "Traverser-v0"}


def test_equal_archives_give_equal_files(suite: Path, tmp_path: Path) -> None:
    first, second = (write_benchmark(tmp_path / name, archives_in(suite)).parent for name in "ab")
    files = sorted(path.relative_to(first) for path in first.rglob("*") if path.is_file())
    assert len(files) == 9
    assert all((first / path).read_bytes() == (second / path).read_bytes() for path in files)


def test_searches_are_compared_at_equal_control_steps(suite: Path) -> None:
    members = read_members(archives_in(suite))
    groups: dict = {}
    for one in members:
        groups.setdefault(one.task, {}).setdefault(one.search, []).append(one)
    found = compare(groups)
    assert (found.left_out, found.steps) == (["Traverser-v0"], {"Catcher-v0": 700, "Walker-v0": 700})
    # after 700 steps all seven designs of the one are done, and three of the other
    known = known_returns()["Walker-v0"]
    expected = {"slow": [4.6, 5.6], "quick<": [5.2, 6.2]}
    for name, values in expected.items():
        assert found.scores[name]["Walker-v0"].tolist() == pytest.approx([known.score(value) for value in values])
    assert found.improvements()["quick<", "slow"].mean == pytest.approx(0.75)
    assert (known.score(known.random), known.score(known.best)) == (0, 1)


def test_progress_holds_the_best_so_far(tmp_path: Path) -> None:
    first = make_search(tmp_path / "a", "Walker-v0", 0, [1.0, 0.5, 2.0], 10)
    second = make_search(tmp_path / "b", "Walker-v0", 1, [0.0, 3.0], 15)
    members = read_members([first, second])
    places, values = progress(members, "evaluations")
    assert (places.tolist(), values.T.tolist()) == ([1, 2, 3], [[1, 1, 2], [0, 3, 3]])
    places, values = progress(members, "steps")
    assert (places.tolist(), values.T.tolist()) == ([15, 20, 30], [[1, 1, 2], [0, 0, 3]])


def test_runs_of_one_algorithm_are_told_apart_by_their_settings(tmp_path: Path) -> None:
    make_search(tmp_path / "a", "Walker-v0", 0, [1.0], max_evaluations=10, population=5)
    make_search(tmp_path / "b", "Walker-v0", 1, [1.0], max_evaluations=20, population=7)
    make_search(tmp_path / "c", "Carrier-v0", 1, [1.0], population=9)
    names = [one.search for one in read_members(archives_in(tmp_path))]
    assert names == ["ga, search.population=5", "ga, search.population=7", "ga"]


def test_a_suite_that_has_only_begun_has_a_report(tmp_path: Path) -> None:
    empty = make_search(tmp_path / "members/Walker-v0/ga/seed0", "Walker-v0", 0, [])
    assert "No design is evaluated yet" in write_benchmark(tmp_path, [empty]).read_text()
    one = make_search(tmp_path / "members/Walker-v0/ga/seed1", "Walker-v0", 1, [float(np.pi)])
    own = make_search(tmp_path / "members/own/ga/seed0", "tasks.py:MINE", 1, [2.0])
    page = write_benchmark(tmp_path, [empty, one, own]).read_text()
    assert "<b>3.142</b>" in page
    assert (tmp_path / "generations/tasks.py_MINE.png").is_file()


def test_every_task_has_its_known_return() -> None:
    known = known_returns()
    assert list(known) == task_ids()
    assert [task for task, one in known.items() if one.best is None] == ["Traverser-v0"]
    for one in known.values():
        if one.best is not None:
            assert one.best > one.random, one
            assert all((one.method, one.source, one.protocol)), one
