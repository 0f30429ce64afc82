"""Figures of a check that may be cut off at any moment: saved whenever one is added, within a time."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

from warpvox.bench.report import Report
from warpvox.io.console import echo

__all__ = ["Progress"]

Item = TypeVar("Item")


class Progress:
    """The findings of the parts of a check so far.

    Files are written whole or not at all, so a reader of the folder, meanwhile or after the process was killed, finds
    everything up to the last row.

    Args:
        report: what is shown.
        seconds: when no row and no part begins any more.

    Attributes:
        figures: of the report: by part a list of rows, or what the part returned; ``seconds`` of each, ``failed`` and
            ``left_out``.
    """

    def __init__(self, report: Report, seconds: float) -> None:
        self.report, self.figures = report, report.figures
        self._end, self._seconds = time.perf_counter() + seconds, seconds
        self.figures |= {"seconds": {}, "failed": [], "left_out": []}

    @property
    def left(self) -> float:
        """Seconds that are left; negative when they are over."""
        return self._end - time.perf_counter()

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
            self.report.note(f"{text}.")
        else:
            echo(self.report.console, f"  {text}")
        self.figures.setdefault(part, []).append(values)
        self.report.write()

    def run(self, name: str, part: Callable[[], Any]) -> None:
        """Do a part if there is time; keep what it returns or how it failed, and its seconds."""
        if not self.time_for(name):
            return
        began = time.perf_counter()
        echo(self.report.console, f"\n{name} ({self.left:.0f} s left)")
        try:
            found = part()
            self.figures.update({} if found is None else {name: found})
        except Exception as error:  # whatever it is, the other parts are worth having
            self.figures["failed"].append(name)
            text = f"{type(error).__name__}: {error}"
            self.figures[f"{name}, error"] = {"error": text, "traceback": traceback.format_exc()}
            self.report.note(f"FAILED, {name}: {text}")
        finally:  # an interrupt, too
            self.figures["seconds"][name] = round(time.perf_counter() - began, 1)
            self.report.write()

    def close(self) -> None:
        """Say what was left out."""
        if self.figures["left_out"]:
            left = ", ".join(self.figures["left_out"])
            self.report.note(f"Left out, for the {self._seconds:g} s were over: {left}.")
