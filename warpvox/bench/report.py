"""The output of a suite: tables and sentences on the terminal, the same as Markdown and JSON."""

import math
import re
import statistics
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console
from rich.table import Table

from warpvox.bench.machine import machine_line
from warpvox.errors import ConfigError
from warpvox.io.console import echo, literal
from warpvox.io.writing import write_text
from warpvox.runs import write_summary

Item = TypeVar("Item")
TABLES = "tables.md"


def middle(values: Sequence[float]) -> float:
    """The median; NaN of nothing."""
    return statistics.median(values) if values else float("nan")


def number(value: float | Sequence[float] | None) -> str:
    """A figure with three significant digits at least and all digits before the point.

    The median of several; a count as it is; - for none or NaN.
    """
    value = middle(value) if isinstance(value, Sequence) else value
    if value is None or value != value:
        return "-"
    if isinstance(value, int):
        return f"{value:,}"
    if value and abs(value) < 1e-3:
        return f"{value:.1e}"
    whole = len(str(int(abs(value)))) if abs(value) >= 1 else 0
    return f"{value:,.{max(3 - whole, 0)}f}"


def spread(value: float | Sequence[float] | None) -> str:
    """The same, and least and most of several in parentheses."""
    if not isinstance(value, Sequence) or len(value) < 2:
        return number(value)
    return f"{number(value)} ({number(min(value))} to {number(max(value))})"


class Report:
    """Collects what a suite shows on ``console``, for the files in ``folder``, which exists.

    Files are written whole or not at all: after :meth:`row` and :meth:`run` the folder has everything up to there,
    whatever becomes of the process.

    Attributes:
        figures: JSON values for ``summary.json``, after ``about``: every table with all repetitions; of the parts of a
            suite a list of rows or what they returned, their ``seconds``, which have ``failed``, what was ``left_out``.
        end: when, by ``time.perf_counter()``, no row and no part begins any more.
    """

    def __init__(self, console: Console, folder: Path, about: dict[str, Any]) -> None:
        self.console, self.folder, self.end = console, folder, math.inf
        self.figures: dict[str, Any] = about | {"tables": [], "seconds": {}, "failed": [], "left_out": []}
        self._texts: list[str] = []

    def table(
        self, title: str, headings: Sequence[str], rows: Sequence[Sequence[Any]], show: Callable[[Any], str] = number
    ) -> None:
        """Show a table; the first column is text, the others are text or what ``show`` makes of figures."""
        echo(self.console, f"\n{title}")
        texts = [[cell if isinstance(cell, str) else show(cell) for cell in row] for row in rows]
        shown = Table()
        for column, heading in enumerate(headings):
            shown.add_column(literal(heading), justify="right" if column else "left")
        for row in texts:
            shown.add_row(*map(literal, row))
        self.console.print(shown)
        self.figures["tables"].append({"title": title, "headings": list(headings), "rows": list(map(list, rows))})
        lines = [headings, ["---", *["---:"] * (len(headings) - 1)], *texts]
        self._texts.append("\n".join([f"{title}:", "", *("| " + " | ".join(line) + " |" for line in lines)]))

    def note(self, text: str) -> None:
        """Show a sentence."""
        echo(self.console, text)
        self._texts.append(text)

    def write(self) -> str:
        """Write all tables and sentences as ``tables.md``, the figures as ``summary.json``; returns the text."""
        text = "\n\n".join([*self._texts, f"Machine: {machine_line(self.figures['machine'])}."]) + "\n"
        write_text(self.folder / TABLES, text)
        write_summary(self.folder, self.figures)
        return text

    @property
    def left(self) -> float:
        """Seconds that are left; negative when they are over."""
        return self.end - time.perf_counter()

    def time_for(self, what: str) -> bool:
        """Whether time is left for something; if not, it is noted as left out."""
        if self.left <= 0:
            self.figures["left_out"].append(what)
        return self.left > 0

    def in_time(self, part: str, items: Iterable[Item], name: str = "{}") -> Iterator[Item]:
        """Those items of a part for which time is left when their turn comes; ``name``: how they are called."""
        return (item for item in items if self.time_for(f"{part}: {name.format(item)}"))

    def row(self, part: str, text: str, noted: bool = False, **values: Any) -> None:
        """Show a line and keep its values; ``noted``: the line stands among the tables, too."""
        if noted:
            self.note(f"{text}.")
        else:
            echo(self.console, f"  {text}")
        self.figures.setdefault(part, []).append(values)
        self.write()

    def run(self, name: str, part: Callable[[], Any]) -> None:
        """Do a part if there is time; keep what it returns or how it failed, and its seconds."""
        if not self.time_for(name):
            return
        began = time.perf_counter()
        echo(self.console, f"\n{name} ({self.left:.0f} s left)")
        try:
            found = part()
            self.figures |= {} if found is None else {name: found}
        except Exception as error:  # whatever it is, the other parts are worth having
            self.figures["failed"].append(name)
            text = f"{type(error).__name__}: {error}"
            self.figures[f"{name}, error"] = {"error": text, "traceback": traceback.format_exc()}
            self.note(f"FAILED, {name}: {text}")
        finally:  # an interrupt, too
            self.figures["seconds"][name] = round(time.perf_counter() - began, 1)
            self.write()


def put_into(path: Path, suite: str, text: str | None = None) -> None:
    """Replace what stands between ``<!-- bench SUITE -->`` and ``<!-- end -->`` by ``text``; None: check the place."""
    if not path.is_file():
        raise ConfigError(f"document={path} is no file.")
    whole, (begin, end) = path.read_text(encoding="utf-8"), (f"<!-- bench {suite} -->\n", "<!-- end -->")
    place = re.search(f"(?<={re.escape(begin)}).*?(?={end})", whole, re.DOTALL)
    if place is None:
        raise ConfigError(f"{path} has no place for this suite: expected '{begin.strip()}' and '{end}'.")
    if text is not None:
        write_text(path, whole[: place.start()] + text + whole[place.end() :])
