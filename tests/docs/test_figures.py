"""Charts and tables of pages are those of the benchmarks and tasks."""

import re
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
    return text_of("docs/figures.md").split(f"<!-- bench {suite} -->")[1].split("<!-- end -->")[0]


def cells(text: str, first: str) -> list[str]:
    """Cells of the row that begins with ``first``, without the ranges in brackets."""
    (line,) = re.findall(rf"^\| {re.escape(first)} \| (.+) \|$", text, re.MULTILINE)
    return [re.sub(r" \(.*", "", cell) for cell in line.split(" | ")]


def row_of(benchmark: str, first: str) -> dict[str, str]:
    """The first row of a benchmark's tables that begins with ``first``, by its columns."""
    rows = [row for table in compare_figures.tables(tables(benchmark)) for row in table]
    return next(row for row in rows if next(iter(row.values())) == first)


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


PAPER_ROW = re.compile(r"^\| ([\w-]+-v\d(?:, [\w-]+-v\d)*) \| ([a-z, ]+) \| .+ \| .+ \|$", re.MULTILINE)
WORDS = {"ends": "terminations", "max episode steps": "max_episode_steps"}


def test_the_page_of_the_paper_lists_every_difference_of_a_task() -> None:
    named: dict[str, set[str]] = {}
    for tasks, parts in PAPER_ROW.findall(text_of("docs/paper.md")):
        for task in tasks.split(", "):
            named.setdefault(task, set()).update(WORDS.get(part, part) for part in parts.split(", "))
    changed = {task: set(get_task(task).paper) for task in task_ids()}
    assert named == {task: parts for task, parts in changed.items() if parts}
