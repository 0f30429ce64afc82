"""Compares searches in ``docs/search.md`` by committed data. Not part of the library.

    python docs/comparison.py add FOLDER ...   # members of suites that are done, into docs/results/searches.csv
    python docs/comparison.py                  # the table of the page

A suite may be run in parts, at different times: rows of the same search, task and seed replace each other.
``tests/docs`` says when the page is out of date.
"""

import json
import re
import statistics
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from warpvox.envs.registry import known_returns
from warpvox.io.reading import read_table
from warpvox.io.writing import write_table, write_text

FOLDER = Path(__file__).resolve().parent
TABLE, PAGE = FOLDER / "results" / "searches.csv", FOLDER / "search.md"
COLUMNS = ("search", "task", "seed", "best_fitness", "control_steps", "evaluations", "wall_s", "commit")
"""Columns; unknown values are empty: ``wall_s`` where a search was stopped and went on."""
BEGIN, END = "<!-- comparison of searches -->", "<!-- end of comparison -->"
BASE = "ga"
"""Search that the others are compared with."""

Row = Mapping[str, str]


def page(text: str, rows: Sequence[Row]) -> str:
    """A page with the table between its marks."""
    return re.sub(f"{BEGIN}.*?{END}", f"{BEGIN}\n\n{table(rows)}\n\n{END}", text, flags=re.DOTALL)


def table(rows: Sequence[Row]) -> str:
    """Mean returns of each task and search with those of all seeds, and in how many pairs a search beats the first."""
    found: dict[str, dict[str, dict[int, float]]] = {}
    for row in rows:
        returns = found.setdefault(row["task"], {}).setdefault(row["search"], {})
        returns[int(row["seed"])] = float(row["best_fitness"])
    searches = sorted({row["search"] for row in rows}, key=lambda name: (name != BASE, name))
    lines = [
        f"| task | {' | '.join(f'`{name}`' for name in searches)} | best published |",
        f"|---{'|---:' * (len(searches) + 1)}|",
    ]
    for task, by_search in sorted(found.items()):
        cells = [_cell(by_search.get(name, {})) for name in searches]
        lines.append(f"| {task} | {' | '.join(cells)} | {known_returns()[task].best:.3f} |")
    verdicts = [_verdict(name, found) for name in searches if name != BASE]
    return "\n".join([*lines, *(["", *verdicts] if verdicts else [])])


def _cell(returns: Mapping[int, float]) -> str:
    if not returns:
        return ""
    each = ", ".join(f"{returns[seed]:.3f}" for seed in sorted(returns))
    return f"{statistics.fmean(returns.values()):.3f} ({each})"


def _verdict(name: str, found: Mapping[str, Mapping[str, Mapping[int, float]]]) -> str:
    both = [(tasks[BASE], tasks[name]) for tasks in found.values() if BASE in tasks and name in tasks]
    pairs = [(base[seed], ours[seed]) for base, ours in both for seed in base.keys() & ours.keys()]
    means = sum(statistics.fmean(ours.values()) > statistics.fmean(base.values()) for base, ours in both)
    better = sum(ours > base for base, ours in pairs)
    return (
        f"The mean of `{name}` is above that of `{BASE}` in {means} of {len(both)} tasks; it is better in {better} of"
        f" {len(pairs)} pairs with the same task and seed."
    )


def with_suite(rows: Sequence[Row], folder: Path) -> list[Row]:
    """Rows with those of a suite's members that are done."""
    by_name = {(row["search"], row["task"], int(row["seed"])): row for row in rows}
    for member in read_table(folder / "members.csv"):
        if member["state"] == "done":
            summary = json.loads((folder / member["folder"] / "summary.json").read_text(encoding="utf-8"))
            row = member | {"commit": summary["commit"], "best_fitness": f"{float(member['best_fitness']):.6g}"}
            by_name[row["search"], row["task"], int(row["seed"])] = {name: row[name] for name in COLUMNS}
    return [by_name[key] for key in sorted(by_name)]


def main(words: Sequence[str]) -> None:
    """See the top of this file."""
    if words[:1] == ["add"]:
        rows: list[Row] = list(read_table(TABLE))
        for folder in words[1:]:
            rows = with_suite(rows, Path(folder))
        write_table(TABLE, COLUMNS, ([row[name] for name in COLUMNS] for row in rows))
    elif words:
        raise SystemExit(__doc__)
    write_text(PAGE, page(PAGE.read_text(encoding="utf-8"), read_table(TABLE)))


if __name__ == "__main__":
    main(sys.argv[1:])
