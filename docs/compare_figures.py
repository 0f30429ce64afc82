"""Compares tables of ``warpvox bench`` with those of ``docs/figures.md``: ``python docs/compare_figures.py FOLDER``.

Not part of the library; ``make bench`` runs it. Exit code 1 if a ratio to EvoGym has fallen by more than a third, or a
walker needs more than half as many control steps again to learn.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

FIGURES = Path(__file__).parent / "figures.md"
LEAST_RATIO, MOST_STEPS = 0.67, 1.5
COMPARED = {"ratio": (LEAST_RATIO, float("inf")), "control steps": (0.0, MOST_STEPS)}
"""Columns, and between what a new figure may be, as a share of the old one."""
TABLE = re.compile(r"^\|(.*)\|\n\|[ -:|]+\|\n((?:\|.*\|\n)+)", re.MULTILINE)


def figures(text: str) -> dict[tuple[str, str], float]:
    """(first cell of the row, column) -> number, of all tables of a page that have a compared column."""
    found = {}
    for head, rows in TABLE.findall(text):
        columns = [cell.strip() for cell in head.split("|")]
        for row in rows.splitlines():
            cells = [cell.strip() for cell in row.strip("|").split("|")]
            for column, cell in zip(columns, cells, strict=True):
                if column in COMPARED and re.fullmatch(r"[\d,.]+", cell):
                    found[cells[0], column] = float(cell.replace(",", ""))
    return found


def compare(old: dict[tuple[str, str], float], new: dict[tuple[str, str], float]) -> list[str]:
    """A line for each figure that is worse than it may be."""
    return [
        f"{row}, {column}: {old[row, column]:g} before, {value:g} now"
        for (row, column), value in new.items()
        if (row, column) in old and not COMPARED[column][0] <= value / old[row, column] <= COMPARED[column][1]
    ]


if __name__ == "__main__":
    tables = [path.read_text(encoding="utf-8") for path in Path(sys.argv[1]).rglob("tables.md")]
    old, new = figures(FIGURES.read_text(encoding="utf-8")), {}
    for table in tables:
        new |= figures(table)
    worse = compare(old, new)
    print(*worse, f"{len(old.keys() & new.keys())} figures compared, {len(worse)} worse", sep="\n")
    sys.exit(bool(worse) or not old.keys() & new.keys())
