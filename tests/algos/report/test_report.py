"""The report: it says what the archive says, and needs nothing from elsewhere."""

import html
import math
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from codesign_toys import make_loop
from hypothesis import given, strategies as st

from warpvox.algos.candidate import Candidate, Outcome
from warpvox.algos.codesign.archive import Archive, Finished, Record
from warpvox.algos.report import family_tree, places, report_page, write_report
from warpvox.algos.report.charts import Series, chart, ticks
from warpvox.design import sample_design


class Page(HTMLParser):
    """Checks that what is opened is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attributes: list) -> None:
        if tag not in ("meta", "link", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_startendtag(self, tag: str, attributes: list) -> None:
        pass


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
    Page(text)
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
        text = write_report(archive, tmp_path / "report.html", {"task": "Walker-v0"}).read_text()
        assert "No design is evaluated yet" in text
        assert "{{rows}}" in text  # a setting, not a slot
        archive.propose([Candidate(0, sample_design((3, 3), 0))], 0)
        Page(report_page(archive, {}, Path()))
        archive.finish([Finished(0, Outcome(-3.0))])
        Page(report_page(archive, {}, Path()))


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


@given(st.data())
def test_in_a_tree_no_two_share_a_place_and_children_are_to_the_right(data: st.DataObject) -> None:
    with_parents = [()]
    generation = [0]
    for number in range(1, data.draw(st.integers(1, 14))):
        parents = tuple(data.draw(st.lists(st.integers(0, number - 1), max_size=2, unique=True)))
        with_parents.append(parents)
        generation.append(1 + max((generation[parent] for parent in parents), default=-1))
    body = sample_design((2, 2), 0)
    records = [
        _record(Candidate(k, body, parents, "x", generation[k]), float(k)) for k, parents in enumerate(with_parents)
    ]
    where = places(records)
    assert len(set(where.values())) == len(records)
    for record in records:
        for parent in record.candidate.parents:
            assert where[parent][0] < where[record.id][0]


def _record(candidate: Candidate, fitness: float) -> Record:
    return Record(candidate, 0, fitness)


def test_a_long_line_is_cut_and_says_so() -> None:
    body = sample_design((2, 2), 0)
    line = [_record(Candidate(k, body, (k - 1,) if k else (), "mutation", k), 0.0) for k in range(100)]
    text = family_tree(line)
    assert "40 earlier ancestors" in text
    root = ET.fromstring(text[text.index("<div") :])
    assert len(root.findall(".//g")) == 60
    assert len(root.findall(".//path[@class='edge']")) == 59
    assert [node.find("text").text for node in root.findall(".//g[@class='node winner']")] == ["#99"]


@pytest.mark.skipif(shutil.which("chromium") is None, reason="chromium is not installed")
def test_the_page_runs_in_a_browser(archive: Archive, tmp_path: Path) -> None:
    """Sorted by fitness by clicks on the heading, and without a word on the console."""
    text = report_page(archive, {"task": "Walker-v0"}, Path())
    # a script of the test's own, after the page's: its policy allows scripts in the page only
    probe = (
        "<script>document.querySelectorAll('th button')[1].click(); document.getElementById('theme').click();"
        "document.title = document.documentElement.dataset.theme + ' ' + [...document.querySelectorAll("
        "'#all tbody tr')].map((row) => row.cells[0].textContent).join(' ')</script>"
    )
    page = tmp_path / "report.html"
    page.write_text(text.replace("</body>", probe + "</body>"))
    command = [
        "chromium",
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--enable-logging=stderr",
        "--dump-dom",
        page.as_uri(),
    ]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert "CONSOLE" not in run.stderr
    theme, *order = re.search(r"<title>([^<]*)</title>", run.stdout)[1].split()
    assert theme == "dark"
    records = archive.records()
    known = {record.id: -math.inf if record.fitness is None else record.fitness for record in records}
    assert [int(number) for number in order] == sorted(known, key=lambda number: (-known[number], number))
