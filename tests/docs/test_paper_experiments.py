"""The page of the paper's experiments is what its command makes of the committed tables; each search is made once."""

import re
from pathlib import Path

import paper_experiments as experiments

from warpvox.algos.suite.members import DONE
from warpvox.cli.suite_plan import BENCHMARK10
from warpvox.envs.registry import known_returns
from warpvox.io.writing import claimed


def row(task: str, search: str, seed: int, value: float, noise: float) -> dict[str, str]:
    known = {"task": task, "search": search, "seed": seed, "return": value, "noise": noise, "seconds": 600}
    return {name: str(known.get(name, "")) for name in experiments.COLUMNS}


def test_page_and_chart_are_up_to_date() -> None:
    rows = experiments.read_rows(experiments.MEMBERS)
    # what "three seeds of each search on each task" rests on
    assert set(map(experiments._key, rows)) == {one.key for one in experiments.members()}
    made = {
        experiments.PAGE: experiments.page(rows),
        experiments.CHART: experiments.picture(experiments.read_rows(experiments.CURVES)),
    }
    assert made == {path: path.read_text(encoding="utf-8") for path in made}


def test_the_order_lets_a_cut_be_useful() -> None:
    every = experiments.members()
    assert len({one.key for one in every}) == len(every) == 156
    quick = [task for task in BENCHMARK10 if task != experiments.SLOWEST]
    assert {one.key for one in every[:27]} == {(t, s, 0) for t in quick for s in experiments.SEARCHES}
    assert {(one.search, one.seed) for one in every[27:49]} == {("ga", 0)}
    assert {one.task for one in every[147:]} == {experiments.SLOWEST}
    assert {one.settings.search.max_evaluations for one in every} == {20_000_000 // (32 * 64 * 60)}


def test_the_page_compares_the_searches() -> None:
    rows = []
    for one in experiments.members():
        known = known_returns()[one.task]
        best = 10.0 if known.best is None else known.best
        half = (best + known.random) / 2
        value, noise = {
            "ga": (best + one.seed - 1, best + one.seed),
            "bo_paper": (best - 1, best),
            "cppn_neat": (half, best + one.seed),
        }[one.search]
        rows.append(row(*one.key, value, noise))
    text = experiments.page(rows)
    assert "| Walker-v0 | 10.598 (9.598 to 11.598) | 11.598 (10.598 to 12.598) | 10.598 | AIEA |" in text
    assert re.search(r"^\| Walker-v0 \| \*\*10.598\*\* \| 9.598 \|.*\*\*11.598\*\* \| 10.598 \| \*\*11.598", text, re.M)
    assert "highest mean on 10 of 10 tasks (BO 0, CPPN-NEAT 0), under noise on 0 (BO 0,\nCPPN-NEAT 0)" in text  # ties
    assert re.search(r"^\| BO \| .*\| 1.000 \[1.000, 1.000\] \| 0.833 .*\| 0.833 ", text, re.M)
    assert re.search(r"^\| CPPN-NEAT \| 0.500 \[0.500, 0.500\] \| .*\| 0.500 ", text, re.M)


def test_a_search_is_made_by_one_process_and_once(tmp_path: Path, monkeypatch) -> None:
    made, (first, second, third) = [], experiments.members()[:3]
    monkeypatch.setattr(experiments, "RESULTS", tmp_path)
    monkeypatch.setattr(experiments, "members", lambda: [first, second, third])
    monkeypatch.setattr(experiments, "make_member", lambda settings, place: made.append(place) or {"status": DONE})
    monkeypatch.setattr(experiments, "store", lambda folder, member, place: None)
    experiments.write_table(tmp_path / experiments.MEMBERS, experiments.COLUMNS, [row(*first.key, 1, 1).values()])
    (tmp_path / second.folder).mkdir(parents=True)
    with claimed(tmp_path / second.folder):
        experiments.run(tmp_path)
    assert made == [tmp_path / third.folder / "search"]
    experiments.run(tmp_path)
    assert made[1:] == [tmp_path / one.folder / "search" for one in (second, third)]
