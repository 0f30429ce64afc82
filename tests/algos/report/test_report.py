"""The report of a search says what the archive says, and needs nothing from elsewhere; several searches as curves."""

import html
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from codesign_toys import make_loop
from hypothesis import given, settings, strategies as st

from warpvox.algos.archive import FILE, Archive, Finished, Record, archives_in
from warpvox.algos.candidate import Candidate, Outcome
from warpvox.algos.report import family_tree, places, report_page
from warpvox.algos.report.charts import Series, chart, sparkline, ticks
from warpvox.algos.report.members import progress, read_members
from warpvox.design import sample_design
from warpvox.envs.registry import known_returns, task_ids


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Archive:
    """A finished experiment of five generations and the beginning of a sixth."""
    loop = make_loop(tmp_path_factory.mktemp("run"))
    loop.run()
    loop.archive.propose([Candidate(30, sample_design((3, 3), 0), (2, 5), "<odd> & more", 5)], 0)
    yield loop.archive
    loop.archive.close()


def test_every_design_has_its_row(archive: Archive) -> None:
    text = report_page(archive, {"task": "Walker-v0"}, Path())
    found = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr[^>]*>(.*?)</tr>", text, re.DOTALL)]
    rows = [[html.unescape(re.sub("<[^>]*>", "", cell)) for cell in row] for row in found if row]
    for row, record in zip(rows, archive.records(), strict=True):
        assert row[0] == str(record.id)
        assert row[2] == ("" if record.fitness is None else f"{record.fitness:.4f}")
        assert row[3] == str(record.candidate.generation)
        assert row[5] == ", ".join(f"#{parent}" for parent in record.candidate.parents)
    assert (rows[-1][4], rows[-1][-1]) == ("<odd> & more", "waiting")


def test_the_figures_are_those_of_the_archive(archive: Archive) -> None:
    text = report_page(archive, {"task": "Walker-v0", "search": "a < b", "status": "running"}, Path())
    best = archive.best(10)
    shown = [float(value) for value in re.findall(r"<figcaption><b>([^<]*)</b>", text)]
    assert shown == [round(record.fitness, 3) for record in best]
    facts = dict(re.findall(r"<dt>([^<]*)</dt><dd>([^<]*)</dd>", text))
    assert facts["best fitness"] == f"{best[0].fitness:.3f}"
    assert facts["evaluations"] == f"{archive.trained()} (+{30 - archive.trained()} reused)"
    assert facts["search"] == "a &lt; b"


def test_nothing_comes_from_elsewhere(archive: Archive) -> None:
    text = report_page(archive, {}, Path())
    assert re.findall(r"""(?:src|href)=["']?([^"'> ]+)""", text) == ["data:,"]
    assert not re.search(r"https?:|@import|url\(", text)
    assert "default-src 'none'" in text


def test_an_empty_archive_has_a_report(tmp_path: Path) -> None:
    with Archive.create(tmp_path / "a.sqlite", {"x": "{{rows}}"}) as archive:
        text = report_page(archive, {"task": "Walker-v0"}, tmp_path)
        assert "No design is evaluated yet" in text
        assert "{{rows}}" in text  # a setting, not a slot
        archive.propose([Candidate(0, sample_design((3, 3), 0))], 0)
        report_page(archive, {}, Path())
        archive.finish([Finished(0, Outcome(-3.0))])
        report_page(archive, {}, Path())


@settings(max_examples=40)
@given(st.floats(-1e3, 1e3), st.floats(1e-1, 1e6))
def test_ticks_are_round_and_inside(low: float, span: float) -> None:
    high = low + span
    values = ticks(low, high)
    assert 2 <= len(values) <= 13
    assert all(low - 1e-6 * span <= value <= high + 1e-6 * span for value in values)
    steps = np.diff(values)
    assert np.allclose(steps, steps[0], rtol=1e-6)
    mantissa = steps[0] / 10.0 ** math.floor(math.log10(steps[0] * 1.0001))
    assert min(abs(mantissa - nice) for nice in (1, 2, 2.5, 5, 10)) < 1e-6


def test_charts_put_points_where_they_belong() -> None:
    points = [(0.0, 1.0), (5.0, 3.0), (10.0, 2.0), (7.0, math.nan)]
    svg = chart([Series("a & b", points, "dots", 3, ["p", "q", "r", "s"])], "x", "y")
    circles = ET.fromstring(svg[svg.index("<svg") :]).findall("circle")
    x, y = ([float(circle.get(name)) for circle in circles] for name in ("cx", "cy"))
    assert [circle.find("title").text for circle in circles] == ["p", "q", "r"]
    assert np.allclose(np.diff(x), [(x[2] - x[0]) / 2] * 2, atol=0.1)
    assert (y[0] - y[2]) == pytest.approx((y[0] - y[1]) / 2, abs=0.1)
    assert y[1] < y[2] < y[0]  # up is less
    assert "a &amp; b" in svg
    assert "Nothing to show" in chart([Series("none", [])], "x", "y")
    for height in (0.0, 2.0, -1e18):  # where all values are the same, they lie in the middle
        (circle,) = re.findall(r'<circle [^>]*cy="([0-9.]+)"', chart([Series("one", [(1.0, height)])], "x", "y"))
        assert float(circle) == (28 + 300) / 2
    assert ' viewBox="0 0 72 20" ' in sparkline([1.0, 3.0, 2.0], 72, 20)


@settings(max_examples=40)
@given(st.data())
def test_in_a_tree_no_two_share_a_place_and_children_are_to_the_right(data: st.DataObject) -> None:
    with_parents = [()]
    generation = [0]
    for number in range(1, data.draw(st.integers(1, 14))):
        parents = tuple(data.draw(st.lists(st.integers(0, number - 1), max_size=2, unique=True)))
        with_parents.append(parents)
        generation.append(1 + max((generation[parent] for parent in parents), default=-1))
    body = sample_design((2, 2), 0)
    records = [Record(Candidate(k, body, parents, "x", generation[k]), 0, k) for k, parents in enumerate(with_parents)]
    where = places(records)
    assert len(set(where.values())) == len(records)
    for record in records:
        for parent in record.candidate.parents:
            assert where[parent][0] < where[record.id][0]


def test_a_long_line_is_cut_and_says_so() -> None:
    body = sample_design((2, 2), 0)
    line = [Record(Candidate(k, body, (k - 1,) if k else (), "mutation", k), 0, 0.0) for k in range(100)]
    text = family_tree(line)
    assert "40 earlier ancestors" in text
    root = ET.fromstring(text[text.index("<div") :])
    assert len(root.findall(".//g")) == 60
    assert len(root.findall(".//path[@class='edge']")) == 59
    assert [node.find("text").text for node in root.findall(".//g[@class='node winner']")] == ["#99"]


def test_the_page_runs_in_a_browser(archive: Archive, tmp_path: Path, open_page: Callable) -> None:
    file = tmp_path / "report.html"
    file.write_text(report_page(archive, {"task": "Walker-v0"}, tmp_path), encoding="utf-8")
    page = open_page(file.as_uri())
    page.locator("th button").nth(1).click()
    page.click("#theme")
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    order = page.evaluate("[...document.querySelectorAll('#all tbody tr')].map((row) => +row.cells[0].textContent)")
    records = archive.records()
    known = {record.id: -math.inf if record.fitness is None else record.fitness for record in records}
    assert order == sorted(known, key=lambda number: (-known[number], number))  # by fitness
    assert page.problems == []


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


def test_progress_holds_the_best_so_far(tmp_path: Path) -> None:
    first = make_search(tmp_path / "a", "Walker-v0", 0, [1.0, 0.5, 2.0], 10)
    second = make_search(tmp_path / "b", "Walker-v0", 1, [0.0, 3.0], 15)
    members = read_members([first, second])
    places, values = progress(members, "evaluations")
    assert (places.tolist(), values.T.tolist()) == ([1, 2, 3], [[1, 1, 2], [0, 3, 3]])
    places, values = progress(members, "steps")
    assert (places.tolist(), values.T.tolist()) == ([15, 20, 30], [[1, 1, 2], [0, 0, 3]])


def test_searches_that_differ_by_anything_are_never_seeds_of_one(tmp_path: Path) -> None:
    for seed in range(18):  # four settings of two values, of which a name tells three; the last two are more seeds
        bits = {name: seed >> k & 1 for k, name in enumerate("abcd")}
        make_search(tmp_path / f"{seed:02}", "Walker-v0", seed, [1.0], **bits)
    names = [one.search for one in read_members(archives_in(tmp_path))]
    assert names[:2] == names[16:] == [f"ga, search.a={a}, search.b=0, search.c=0" for a in (0, 1)]
    assert names[8:10] == [f"{name} #2" for name in names[:2]]
    assert len(set(names)) == 16


def test_every_task_has_its_known_return() -> None:
    known = known_returns()
    assert list(known) == task_ids()
    assert [task for task, one in known.items() if one.best is None] == ["Traverser-v0"]
    for one in known.values():
        if one.best is not None:
            assert one.best > one.random, one
            assert all((one.method, one.source, one.protocol)), one
