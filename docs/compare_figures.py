"""Compares tables of ``benchmarks/`` with those of ``docs/figures.md``: ``python docs/compare_figures.py FOLDER``.

Not part of the library; ``make bench`` runs it. Exit code 1 if a ratio to EvoGym has fallen by more than a third, or a
walker needs more than half as many control steps again to learn.
"""

import re
import sys
from pathlib import Path

FIGURES = Path(__file__).parent / "figures.md"
COMPARED = {"ratio": (0.67, float("inf")), "control steps": (0.0, 1.5)}
"""Columns, and between what a new figure may be, as a share of the old one."""
NARROW = 0.4
"""Factor of the least share where there is no AVX-512, which the old figures were made with."""
TABLE = re.compile(r"^\|(.*)\|\n\|[ -:|]+\|\n((?:\|.*\|\n)+)", re.MULTILINE)


def tables(text: str) -> list[list[dict[str, str]]]:
    """Rows of all tables of a page, as cells by their columns; of columns with one name the last counts."""
    found = []
    for head, rows in TABLE.findall(text):
        columns = [cell.strip() for cell in head.split("|")]
        cells = ([cell.strip() for cell in row.strip("|").split("|")] for row in rows.splitlines())
        found.append([dict(zip(columns, row, strict=True)) for row in cells])
    return found


def figures(text: str) -> dict[tuple[str, str], float]:
    """(first cell of the row, column) -> number, for the compared columns of all tables of a page."""
    return {
        (next(iter(row.values())), column): float(row[column].replace(",", ""))
        for rows in tables(text)
        for row in rows
        for column in COMPARED
        if re.fullmatch(r"[\d,.]+", row.get(column, ""))
    }


def compare(old: dict[tuple[str, str], float], new: dict[tuple[str, str], float], wide: bool = True) -> list[str]:
    """A line for each figure that is worse than it may be."""
    lines = []
    for (row, column), value in new.items():
        before = old.get((row, column))
        least, most = COMPARED[column]
        if before is not None and not least * (1 if wide else NARROW) <= value / before <= most:
            lines.append(f"{row}, {column}: {before:g} before, {value:g} now")
    return lines


def main(folder: str) -> int:
    """Print what is worse. Returns the exit code."""
    text = "".join(path.read_text(encoding="utf-8") for path in sorted(Path(folder).rglob("tables.md")))
    old, new = figures(FIGURES.read_text(encoding="utf-8")), figures(text)
    worse, common = compare(old, new, wide="(AVX512)" in text), len(old.keys() & new.keys())
    print(*worse, f"{common} figures compared, {len(worse)} worse", sep="\n")
    return bool(worse) or not common


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
