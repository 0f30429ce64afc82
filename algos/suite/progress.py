"""Progress of a suite while its members are made, and the table at its end."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Iterator, Sequence
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table as Grid
from rich.text import Text

from warpvox.algos.suite.members import DONE, FAILED, RUNNING, WAITING, Member, Table
from warpvox.errors import counted
from warpvox.io.console import duration, echo, figure, literal

REFRESH_SECONDS = 2.0
"""How often figures of members are read and written while they are made."""
ENDED = 3
"""Members that have ended last, which are shown besides those that run."""


class SuiteProgress:
    """Shows the members that run: a live table on a terminal, else a line when one ends. A context manager."""

    def __init__(self, table: Table, console: Console) -> None:
        self.table, self.console = table, console
        self._began = self._shown = time.monotonic()
        self._start = self._share()
        self._ended: list[Member] = []
        self._live = Live(console=console, refresh_per_second=4, transient=True) if console.is_terminal else None

    def __enter__(self) -> SuiteProgress:
        if self._live is not None:
            self._live.start()
            self._live.update(self._block())
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def ended(self, member: Member) -> None:
        """A member has ended, or has been interrupted."""
        if member.state != WAITING:
            self._ended.append(member)
        figures = member.figures()
        best, designs = _number(figures["best_fitness"]), counted(figures["evaluations"] or 0, "designs")
        state = "interrupted" if member.state == WAITING else member.state
        end = f": {member.error}" if member.error else f", best {figure(best)} of {designs}"
        done, (task, search, seed) = f"{len(self.table.of(DONE, FAILED))}/{len(self.table.members)}", member.key
        echo(self.console, f"[{done}] {task} {search} seed {seed} {state}{end}  left {self._left()}")

    def refresh(self) -> None:
        """Show and store how far members have come, now and then."""
        if time.monotonic() - self._shown < REFRESH_SECONDS:
            return
        self._shown = time.monotonic()
        self.table.write()
        if self._live is not None:
            self._live.update(self._block())

    def _share(self) -> float:
        """How much of the evaluations of all members is done, from 0 to 1."""
        members = self.table.members
        spent = [one.total if one.state in (DONE, FAILED) else one.figures()["evaluations"] or 0 for one in members]
        return sum(spent) / sum(one.total for one in members)

    def _left(self) -> str:
        share = self._share()
        if share <= self._start:
            return "-"
        return duration((time.monotonic() - self._began) / (share - self._start) * (1 - share))

    def _block(self) -> Group:
        counts = self.table.counts
        words = ", ".join(f"{counts[state]} {state}" for state in (DONE, RUNNING, WAITING, FAILED) if state in counts)
        head = Grid.grid(padding=(0, 2))
        head.add_row(ProgressBar(total=1.0, completed=self._share(), width=24), f"{words}", f"left {self._left()}")
        grid = Grid(box=None, padding=(0, 2), header_style="dim")
        for name in ("task", "search", "seed", "state", "designs", "control steps", "best", "time"):
            grid.add_column(name, justify="left" if name in ("task", "search", "state") else "right")
        for member in [*self.table.of(RUNNING), *self._ended[-ENDED:]]:
            grid.add_row(*map(literal, _cells(member)), style="" if member.state == RUNNING else "dim")
        return Group(head, grid)


def _cells(member: Member) -> Iterator[Any]:
    figures = member.figures()
    yield from (*member.key, member.state, f"{figures['evaluations'] or 0}/{member.total}")
    yield from (f"{figures['control_steps'] or 0:,}", figure(_number(figures["best_fitness"])))
    running = member.state == RUNNING and member.began
    yield duration(time.monotonic() - running if running else figures["wall_s"] or 0.0)


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


def results(members: Sequence[Member]) -> Grid:
    """The best fitness by task and search, mean and standard deviation over the seeds that are done."""
    searches = list(dict.fromkeys(member.search for member in members))
    grid = Grid(title="best fitness, mean ± standard deviation over seeds", title_justify="left")
    grid.add_column("task")
    for search in searches:
        grid.add_column(literal(search), justify="right")
    for task in dict.fromkeys(member.task for member in members):
        cells = [_spread([one for one in members if (one.task, one.search) == (task, search)]) for search in searches]
        grid.add_row(literal(task), *map(Text, cells))
    return grid


def _spread(members: Sequence[Member]) -> str:
    values = [_number(member.figures()["best_fitness"]) for member in members if member.state == DONE]
    if not values:
        return "-"
    deviation = f" ± {statistics.stdev(values):.3f}" if len(values) > 1 else ""
    share = f" ({len(values)} of {len(members)})" if len(values) < len(members) else ""
    return f"{statistics.fmean(values):.3f}{deviation}{share}"
