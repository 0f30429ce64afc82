"""The live line of a training run."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from warpvox.cli.console import duration, echo, figure

__all__ = ["TrainingProgress"]

QUIET_SECONDS = 10.0
"""Without a terminal, seconds between lines (an evaluation prints one in any case)."""
WIDE = 110
"""Columns from which on there is room for a bar."""


class TrainingProgress:
    """Shows iterations, speed, returns, time left: a live line on a terminal, else a line now and then.

    Args:
        total: iterations of the whole run.
        done: iterations complete at the start.
    """

    def __init__(self, total: int, done: int = 0, console: Console | None = None) -> None:
        self.console = console or Console()
        self.total = total
        self._start, self._began, self._printed = done, time.monotonic(), time.monotonic()
        self._exploring = math.nan
        self._last_eval = math.nan
        self._diverged = 0
        self._bar = None
        if self.console.is_terminal:
            wide = self.console.width >= WIDE
            self._bar = Progress(
                TextColumn("{task.completed}/{task.total}"),
                *([BarColumn(bar_width=16)] if wide else []),
                TextColumn("{task.fields[figures]}"),
                *([TimeElapsedColumn()] if wide else []),
                TextColumn("left"),
                TimeRemainingColumn(),
                console=self.console,
                refresh_per_second=4,
            )
            self._line = self._bar.add_task("", total=total, completed=done, figures="")

    def __enter__(self) -> TrainingProgress:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, row: Mapping[str, float]) -> None:
        """Show a row of ``metrics.csv``."""
        if math.isfinite(row["return_mean"]):
            self._exploring = row["return_mean"]
        evaluated = math.isfinite(row["eval_return"])
        if evaluated:
            self._last_eval = row["eval_return"]
        self._diverged += int(row["diverged"])
        figures = self._figures(row)
        if self._bar is not None:
            self._bar.update(self._line, completed=row["iteration"], figures=figures)
            return
        now = time.monotonic()
        if evaluated or now - self._printed >= QUIET_SECONDS or row["iteration"] == self.total:
            self._printed = now
            left = self._left(row["iteration"], now)
            echo(self.console, f"iteration {row['iteration']}/{self.total}  {figures}  left {left}")

    def _figures(self, row: Mapping[str, float]) -> str:
        return (
            f"{row['steps_per_second']:,.0f} steps/s  return {figure(self._exploring, 2)}"
            f"  eval {figure(self._last_eval, 2)}  best {figure(row['best_return'], 2)}"
            + (f"  unstable {row['unstable']:.0f}" if row["unstable"] else "")
            + (f"  diverged {self._diverged} in all" if self._diverged else "")
        )

    def _left(self, iteration: int, now: float) -> str:
        return duration((now - self._began) / max(iteration - self._start, 1) * (self.total - iteration))
