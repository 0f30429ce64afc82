"""The members of a suite, their states and results, ``members.csv`` and ``curves.csv``."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from warpvox.algos.codesign.settings import Codesign
from warpvox.algos.report.members import SearchResult, read_members
from warpvox.errors import RunError
from warpvox.io.reading import read_table
from warpvox.io.writing import check_folder, write_table
from warpvox.runs import read_summary

MEMBERS, CURVES = "members.csv", "curves.csv"
WAITING, RUNNING, DONE, FAILED = ("waiting", "running", "done", "failed")
FIGURES = ("evaluations", "control_steps", "wall_s", "best_fitness")
COLUMNS = ("task", "search", "seed", "state", *FIGURES, "folder", "error")
CURVE_COLUMNS = ("task", "search", "seed", "evaluations", "control_steps", "best")


@dataclass(frozen=True)
class Member:
    """One design search of a suite; ``task`` is the id, ``search`` the name of the search's file."""

    task: str
    search: str
    seed: int
    settings: Codesign

    @property
    def key(self) -> tuple[str, str, int]:
        """Key that no other member of the suite has."""
        return self.task, self.search, self.seed

    @property
    def folder(self) -> Path:
        """Folder of its run, in that of the suite."""
        return Path("members", self.task, self.search, f"seed{self.seed}")


@dataclass
class Row:
    """A member: its run's folder, the evaluations that it may spend, its state and the error that it has ended with.

    ``began``: when it was begun or gone on with, by the monotonic clock.
    """

    task: str
    search: str
    seed: int
    folder: Path
    total: int = 0
    state: str = WAITING
    error: str = ""
    curve: list[tuple[int, int, float]] | None = None
    began: float | None = None

    @property
    def key(self) -> tuple[str, str, int]:
        """Key that no other member has."""
        return self.task, self.search, self.seed

    def figures(self) -> dict[str, Any]:
        """``evaluations``, ``control_steps``, ``wall_s`` and ``best_fitness`` so far, of its last whole generation."""
        summary = read_summary(self.folder)
        names = {"control_steps": "steps", "wall_s": "elapsed_seconds"}
        return {name: summary.get(names.get(name, name)) for name in FIGURES}


class Table:
    """The members of a suite with their states and results, in the order in which they are run."""

    def __init__(self, folder: Path, rows: list[Row]) -> None:
        self.folder, self.rows = folder, rows
        self._written: list[tuple[Any, ...]] | None = None

    @classmethod
    def of_members(cls, folder: Path, members: Iterable[Member], retry: bool = False) -> Table:
        """The table of a suite in ``folder``, new or gone on with; ``retry``: members that have failed wait again."""
        before = {row.key: row for row in cls.stored(folder).rows}
        rows = []
        for member in members:
            settings = member.settings
            total = settings.search.max_evaluations + settings.evaluation.finalists
            row = Row(member.task, member.search, member.seed, folder / member.folder, total)
            known = before.get(row.key)
            if read_summary(row.folder).get("status") == DONE:
                row.state = DONE
            elif known is not None and known.state == FAILED and not retry:
                row.state, row.error = known.state, known.error
            rows.append(row)
        return cls(folder, rows)

    @classmethod
    def stored(cls, folder: Path) -> Table:
        """The table as ``members.csv`` has it; without rows if there is no such file, or a damaged one."""
        try:
            rows = [
                Row(one["task"], one["search"], int(one["seed"]), folder / one["folder"], 0, one["state"], one["error"])
                for one in read_table(folder / MEMBERS)
            ]
        except (csv.Error, KeyError, TypeError, ValueError):
            rows = []
        return cls(folder, rows)

    def of(self, *states: str) -> list[Row]:
        """The rows in these states."""
        return [row for row in self.rows if row.state in states]

    @property
    def counts(self) -> dict[str, int]:
        """How many members there are in each state."""
        return dict(Counter(row.state for row in self.rows))

    def write(self) -> None:
        """Write ``members.csv``, by task, search and seed."""
        check_folder(self.folder)
        lines = [
            (*row.key, row.state, *row.figures().values(), row.folder.relative_to(self.folder).as_posix(), row.error)
            for row in self._sorted()
        ]
        if lines != self._written:
            write_table(self.folder / MEMBERS, COLUMNS, lines)
            self._written = lines

    def write_curves(self) -> None:
        """Write ``curves.csv``: the best fitness so far of each member, a line wherever it rises and one at the end."""
        lines = [(*row.key, *point) for row in self._sorted() for point in self._curve(row) or ()]
        write_table(self.folder / CURVES, CURVE_COLUMNS, lines)

    def archives(self) -> list[Path]:
        """The folders of the runs that have an archive which can be read."""
        return [row.folder for row in self._sorted() if self._curve(row) is not None]

    def _sorted(self) -> list[Row]:
        """By task, then search, then seed, each in the order in which the suite names them."""
        orders = [list(dict.fromkeys(row.key[part] for row in self.rows)) for part in range(3)]
        return sorted(self.rows, key=lambda row: tuple(map(list.index, orders, row.key)))

    def _curve(self, row: Row) -> list[tuple[int, int, float]] | None:
        """The curve of a member; of one that is done it is read once, as its archive does not change any more."""
        if row.curve is not None:
            return row.curve
        try:
            (member,) = read_members([row.folder])
        except RunError:  # no archive yet, or one that is damaged, which its member reports
            return None
        curve = rises(member)
        row.curve = curve if row.state == DONE else None
        return curve


def rises(member: SearchResult) -> list[tuple[int, int, float]]:
    """``(evaluations, control steps, best fitness so far)`` wherever the best rises, and at the end."""
    points = zip(member.evaluations.tolist(), member.steps.tolist(), member.best.tolist(), strict=True)
    kept = []
    for point in points:
        if not kept or point[2] > kept[-1][2] or point[0] == member.evaluated:
            kept.append(point)
    return kept
