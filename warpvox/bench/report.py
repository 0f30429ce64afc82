"""The output of a suite: tables and sentences on the terminal, the same as Markdown, and plots."""

from __future__ import annotations

import re
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from warpvox.errors import ConfigError
from warpvox.io.console import echo, literal
from warpvox.io.writing import atomic_path, write_text

__all__ = ["Document", "Report", "middle", "number", "spread"]

TABLES, PLOT_SIZE, DOTS = "tables.md", (8.0, 4.5), 110


class Report:
    """Collects what a suite shows.

    Args:
        console: where it appears at once.
        folder: of the results; must exist.
    """

    def __init__(self, console: Console, folder: Path) -> None:
        self.console, self.folder = console, folder
        self._parts: list[str] = []

    def table(self, title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Show a table; the first column is text, the others are numbers."""
        echo(self.console, f"\n{title}")
        shown = Table()
        for column, heading in enumerate(headings):
            shown.add_column(literal(heading), justify="right" if column else "left")
        for row in rows:
            shown.add_row(*map(literal, row))
        self.console.print(shown)
        lines = [headings, ["---", *["---:"] * (len(headings) - 1)], *rows]
        self._parts.append("\n".join([f"{title}:", "", *("| " + " | ".join(line) + " |" for line in lines)]))

    def note(self, text: str) -> None:
        """Show a sentence."""
        echo(self.console, text)
        self._parts.append(text)

    def status(self, text: str) -> Any:
        """A spinner while something takes time."""
        return self.console.status(text)

    def plot(self, name: str, draw: Callable[[Any], None]) -> None:
        """Write ``<name>.png``: ``draw`` is given a matplotlib figure. Without matplotlib say so."""
        try:
            from matplotlib.figure import Figure
        except ModuleNotFoundError:
            echo(self.console, "no plot: matplotlib is missing (pip install 'warpvox[view]')")
            return
        figure = Figure(figsize=PLOT_SIZE, layout="constrained")
        draw(figure)
        path = self.folder / f"{name}.png"
        with atomic_path(path) as temporary:
            figure.savefig(temporary, dpi=DOTS)
        echo(self.console, f"plot: {path}")

    def write(self) -> str:
        """Write all tables and sentences as ``tables.md``; returns the text."""
        text = "\n\n".join(self._parts) + "\n"
        write_text(self.folder / TABLES, text)
        return text


class Document:
    """A Markdown file with a place for the tables of a suite, between ``<!-- bench SUITE -->`` and ``<!-- end -->``.

    Raises:
        ConfigError: no such file, or no such place in it.
    """

    def __init__(self, path: Path, suite: str) -> None:
        self._path = path
        self._place = re.compile(rf"(<!-- bench {re.escape(suite)} -->\n).*?(<!-- end -->)", re.DOTALL)
        if not path.is_file():
            raise ConfigError(f"document={path} is no file.")
        if not self._place.search(path.read_text(encoding="utf-8")):
            words = f"expected '<!-- bench {suite} -->' and '<!-- end -->'"
            raise ConfigError(f"{path} has no place for this suite: {words}.")

    def replace(self, text: str) -> None:
        """Put ``text`` there."""
        whole = self._path.read_text(encoding="utf-8")
        write_text(self._path, self._place.sub(lambda found: f"{found[1]}{text}{found[2]}", whole))


def middle(values: Sequence[float]) -> float:
    """The median; NaN of nothing."""
    return statistics.median(values) if values else float("nan")


def number(value: float | None, digits: int = 3) -> str:
    """A figure with so many significant digits at least and all digits before the point; - for none or NaN."""
    if value is None or value != value:
        return "-"
    if value and abs(value) < 1e-3:
        return f"{value:.1e}"
    whole = len(str(int(abs(value)))) if abs(value) >= 1 else 0
    return f"{value:,.{max(digits - whole, 0)}f}"


def spread(values: Sequence[float]) -> str:
    """Median and, in parentheses, least and most."""
    if not values:
        return "-"
    if len(values) == 1:
        return number(values[0])
    return f"{number(middle(values))} ({number(min(values))} to {number(max(values))})"
