"""The page of the paper's experiments is what its command makes of the committed tables; each search is made once."""

import re
from pathlib import Path

import paper_experiments as experiments

from warpvox.algos.suite.members import DONE
from warpvox.cli.suite_plan import BENCHMARK10
from warpvox.io.writing import claimed


def row(task: str, search: str, seed: int, value: float, noise: float) -> dict[str, str]:
    known = {"task": task, "search": search, "seed": seed, "return": value, "noise": noise, "seconds": 600}
    return {name: str(known.get(name, "")) for name in experiments.COLUMNS}


def test_page_and_chart_are_up_to_date() -> None:
    rows = experiments.read_rows(experiments.MEMBERS)
    chart = experiments.picture(experiments.read_rows(experiments.CURVES)) if rows else None
    made = {experiments.PAGE: experiments.page(rows), experiments.CHART: chart}
    assert made == {path: path.read_text(encoding="utf-8") if path.is_file() else None for path in made}


def test_the_order_lets_a_cut_be_useful() -> None:
    every = experiments.members()
    assert len({one.key for one in every}) == len(every) == 156
    quick = [task for task in BENCHMARK10 if task != experiments.SLOWEST]
    assert {one.key for one in every[:27]} == {(t, s, 0) for t in quick for s in experiments.SEARCHES}
    assert {(one.search, one.seed) for one in every[27:49]} == {("ga", 0)}
    assert {one.task for one in every[147:]} == {experiments.SLOWEST}
    assert {one.settings.search.max_evaluations for one in every} == {20_000_000 // (32 * 64 * 60)}


def test_the_page_says_what_the_searches_that_are_done_carry() -> None:
    one = [row("Walker-v0", "bo_paper", 0, 10, 9)]
    assert "**1 of 156 searches" in experiments.page(one)
    assert "## " not in experiments.page(one)  # nothing of GA, nothing to compare
    three = [*one, row("Walker-v0", "ga", 0, 10, 9.5), row("Walker-v0", "cppn_neat", 0, 8, 7)]
    text = experiments.page([*three, row("Walker-v0", "ga", 1, 12, 10), row("Traverser-v0", "ga", 0, 5, 4)])
    assert "| Walker-v0 | 2 | 11.000 (10.000 to 12.000) | 9.750 (9.500 to 10.000) | 10.598 |" in text
    assert "| Walker-v0 | 1 | **10.000** | **10.000** | 8.000 | **9.500** | 9.000 | 7.000 |" in text
    assert "interquartile" not in text  # of one seed
    assert "highest mean on 0 of 1 tasks (BO 0, CPPN-NEAT 0), under noise on 1" in text  # a tie is nobody's
    text = experiments.page([*three, *({**one, "seed": "1"} for one in three)])
    assert re.search(r"^\| BO \| 0.945 .*\| 0.852 .*\| 0.500 .*\| 1.000 ", text, re.MULTILINE)


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
