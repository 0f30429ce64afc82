"""Figures and lists that pages repeat are those of the tables and tasks."""

import re
from collections.abc import Iterator
from pathlib import Path

import charts
import compare_figures
import pytest

from warpvox.envs.registry import get_task, task_ids

ROOT = Path(__file__).resolve().parents[2]
ROW = re.compile(r"^\| ([\w-]+-v\d)[^|]* \| ([\d,]+) \| ([\d,]+) \| (\d+) \|$", re.MULTILINE)


def text_of(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def tables(suite: str) -> str:
    """The tables of a benchmark in the page of figures."""
    return text_of("docs/figures.md").split(f"<!-- bench {suite} -->")[1].split("<!-- end -->")[0]


def cells(text: str, first: str) -> list[str]:
    """Cells of the row that begins with ``first``, without the ranges in brackets."""
    (line,) = re.findall(rf"^\| {re.escape(first)} \| (.+) \|$", text, re.MULTILINE)
    return [re.sub(r" \(.*", "", cell) for cell in line.split(" | ")]


def row_of(benchmark: str, first: str) -> dict[str, str]:
    """The first row of a benchmark's tables that begins with ``first``, by its columns."""
    rows = [row for table in compare_figures.tables(tables(benchmark)) for row in table]
    return next(row for row in rows if next(iter(row.values())) == first)


def phrases() -> Iterator[tuple[str, str]]:
    """Pages, and the words that they must have."""
    median, least, most = re.search(r"Ratio: median (\S+), least (\S+), most (\S+)\.", tables("tasks")).groups()
    fast = (
        f"{float(least):.0f} to {most} times Evolution Gym on one CPU core with AVX-512 (median of all tasks: {median}"
    )
    yield "README.md", fast
    narrow = re.search(r"printed: ratio median (\S+), least (\S+) \(.+?\), most (\S+)", text_of("docs/figures.md"))
    middle, low, high = (f"{float(value):.0f}" for value in narrow.groups())
    yield "README.md", f"{low} to {high} times ({middle})"
    yield "docs/index.md", f"**{median} times** EvoGym's speed on one CPU core with AVX-512"
    yield "docs/index.md", f"the median of all tasks (without: {middle})"
    yield "docs/performance.md", f"{low} to {high} times, the median {middle}"
    took, steps = re.search(r"in (\S+) s \(`ppo=parallel`, (\S+) control steps", text_of("docs/figures.md")).groups()
    yield "docs/performance.md", f"two of the old ones it took {steps} control steps and {float(took):.0f} s"
    yield "docs/performance.md", f"{float(least):.0f} to {most} times as many control steps"
    yield "docs/performance.md", f"the median of all tasks is {median}"
    batch = cells(tables("tasks"), "Walker-v0")[-1]
    single = cells(tables("peer"), "warpvox, one gymnasium environment")[-1]
    yield (
        "docs/faq.md",
        f"gymnasium runs {float(single):.0f} times as fast as EvoGym's; 512 of `make_vec` run {batch} times as fast",
    )
    rate = cells(tables("peer"), "warpvox, one gymnasium environment")[0]
    yield "docs/performance.md", f"{rate} control steps a second ({float(single):.0f} times EvoGym's)"
    share, seconds = re.search(r"step at (\d+)% of the speed .* built in (\S+) s;", tables("scaling")).groups()
    yield "docs/performance.md", f"built in {seconds} s and runs at {share} % of the speed of 512 copies"
    learned = row_of("learning", "ppo=parallel, 512 environments")
    seconds, steps = learned["seconds"], learned["control steps"]
    yield (
        "docs/performance.md",
        f"a return of 10 after {steps} control steps, in {float(seconds):.0f} s on two cores",
    )
    largest = int(row_of("gpu", "65,536")["step only"].replace(",", ""))
    evogym = int(cells(tables("peer"), "evogym 2.0.0, Python 3.10.13")[0])
    for page in ("README.md", "docs/performance.md", "CHANGELOG.md"):
        yield page, f"{largest / 1e6:.1f} million control steps a second"
    yield "docs/index.md", f"**{largest / 1e6:.1f} million** control steps a second"
    yield "docs/performance.md", f"{round(largest / evogym, -3):,.0f} cores make with EvoGym ({evogym} on one core"


def test_the_charts_are_those_of_the_tables() -> None:
    for name, picture in charts.charts(text_of("docs/figures.md"), text_of("docs/results.md")).items():
        assert (charts.IMAGES / name).read_text(encoding="utf-8") == picture, "run `make charts`"


def test_worse_figures_are_found() -> None:
    old = compare_figures.figures(text_of("docs/figures.md"))
    slow = {place: value / 2 if place[1] == "ratio" else value * 2 for place, value in old.items()}
    assert len(old) > 40
    assert len(compare_figures.compare(old, slow)) == len(old)
    assert not compare_figures.compare(old, old)


@pytest.mark.parametrize(
    ("vectors", "ratio", "code"), [("AVX512", 88, 1), ("AVX512", 176, 0), ("AVX2", 88, 0), ("AVX2", 40, 1)]
)
def test_without_avx_512_less_is_expected(vectors: str, ratio: int, code: int, tmp_path: Path) -> None:
    table = f"| task | ratio |\n| --- | ---: |\n| Walker-v0 | {ratio} |\n"
    (tmp_path / "tables.md").write_text(f"{table}\nMachine: 2 usable cores of AMD EPYC ({vectors}); Python 3.11.7.\n")
    assert compare_figures.main(str(tmp_path)) == code


@pytest.mark.parametrize(("page", "words"), list(phrases()))
def test_a_page_repeats_a_figure(page: str, words: str) -> None:
    assert words in " ".join(text_of(page).split())


def test_the_table_of_readme_is_a_part_of_the_tables() -> None:
    rows = ROW.findall(text_of("README.md"))
    assert len(rows) > 3
    *batches, (task, *single) = rows
    for name, *shown in batches:
        row = row_of("tasks", name)
        assert shown == [row["step only"], row["reference"], f"{float(row['ratio']):.0f}"]
    ours, *_, ratio = cells(tables("peer"), "warpvox, one gymnasium environment")
    reference, *_ = cells(tables("peer"), "evogym 2.0.0, Python 3.10.13")
    assert (task, *single) == ("Walker-v0", ours, reference, f"{float(ratio):.0f}")


PAGE = Path(__file__).resolve().parents[2] / "docs" / "paper.md"
PAPER_ROW = re.compile(r"^\| ([\w-]+-v\d(?:, [\w-]+-v\d)*) \| ([a-z, ]+) \| .+ \| .+ \|$", re.MULTILINE)
WORDS = {"ends": "terminations", "max episode steps": "max_episode_steps"}


def test_the_table_is_complete() -> None:
    named: dict[str, set[str]] = {}
    for tasks, parts in PAPER_ROW.findall(PAGE.read_text(encoding="utf-8")):
        for task in tasks.split(", "):
            named.setdefault(task, set()).update(WORDS.get(part, part) for part in parts.split(", "))
    changed = {task: set(get_task(task).paper) for task in task_ids()}
    assert named == {task: parts for task, parts in changed.items() if parts}


def test_the_number_of_tasks_that_differ_is_the_one_that_is_printed() -> None:
    count = sum(bool(get_task(task).paper) for task in task_ids())
    assert f"{count} of the {len(task_ids())} tasks" in " ".join(PAGE.read_text(encoding="utf-8").split())
    readme = (PAGE.parents[1] / "README.md").read_text(encoding="utf-8")
    assert f"differ in {count} tasks" in " ".join(readme.split())
