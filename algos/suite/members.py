"""The members of a suite, their states and results, ``members.csv`` and ``curves.csv``."""

from __future__ import annotations

import csv
import dataclasses
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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


@dataclass
class Member:
    """One design search of a suite: its settings, its state and the error that it has ended with.

    Attributes:
        task, search: the id of the task, the name of the search's file.
        folder: of its run; in a plan, seen from that of the suite.
        settings: a :class:`Codesign`; None where only its row of ``members.csv`` is known.
        began: when it was begun or gone on with, by the monotonic clock.
    """

    task: str
    search: str
    seed: int
    folder: Path
    settings: Any = None
    state: str = WAITING
    error: str = ""
    curve: list[tuple[int, int, float]] | None = None
    began: float | None = None

    @property
    def key(self) -> tuple[str, str, int]:
        """Key that no other member of the suite has."""
        return self.task, self.search, self.seed

    @property
    def total(self) -> int:
        """The evaluations that it may spend."""
        return self.settings.search.max_evaluations + self.settings.evaluation.finalists

    def figures(self) -> dict[str, Any]:
        """``evaluations``, ``control_steps``, ``wall_s`` and ``best_fitness`` so far, of its last whole generation."""
        summary = read_summary(self.folder)
        names = {"control_steps": "steps", "wall_s": "elapsed_seconds"}
        return {name: summary.get(names.get(name, name)) for name in FIGURES}


class Table:
    """The members of a suite with their states and results, in the order in which they are run."""

    def __init__(self, folder: Path, members: list[Member]) -> None:
        self.folder, self.members = folder, members
        self._written: list[tuple[Any, ...]] | None = None

    @classmethod
    def of_plan(cls, folder: Path, plan: Iterable[Member], retry: bool) -> Table:
        """The table of a suite in ``folder``, new or gone on with; ``retry``: members that have failed wait again."""
        before = {member.key: member for member in cls.stored(folder).members}
        members = []
        for planned in plan:
            member = dataclasses.replace(planned, folder=folder / planned.folder)
            known = before.get(member.key)
            if read_summary(member.folder).get("status") == DONE:
                member.state = DONE
            elif known is not None and known.state == FAILED and not retry:
                member.state, member.error = known.state, known.error
            members.append(member)
        return cls(folder, members)

    @classmethod
    def stored(cls, folder: Path) -> Table:
        """The table as ``members.csv`` has it; without members if there is no such file, or a damaged one."""
        members = []
        try:
            for row in read_table(folder / MEMBERS):
                key = row["task"], row["search"], int(row["seed"])
                members.append(Member(*key, folder / row["folder"], state=row["state"], error=row["error"]))
        except (csv.Error, KeyError, TypeError, ValueError):
            return cls(folder, [])
        return cls(folder, members)

    def of(self, *states: str) -> list[Member]:
        return [member for member in self.members if member.state in states]

    @property
    def counts(self) -> dict[str, int]:
        return dict(Counter(member.state for member in self.members))

    def write(self) -> None:
        """Write ``members.csv``, by task, search and seed."""
        check_folder(self.folder)
        lines = [
            (*one.key, one.state, *one.figures().values(), one.folder.relative_to(self.folder).as_posix(), one.error)
            for one in self._sorted()
        ]
        if lines != self._written:
            write_table(self.folder / MEMBERS, COLUMNS, lines)
            self._written = lines

    def write_curves(self) -> None:
        """Write ``curves.csv``: the best fitness so far of each member, a line wherever it rises and one at the end."""
        lines = [(*member.key, *point) for member in self._sorted() for point in self._curve(member) or ()]
        write_table(self.folder / CURVES, CURVE_COLUMNS, lines)

    def archives(self) -> list[Path]:
        """The folders of the runs that have an archive which can be read."""
        return [member.folder for member in self._sorted() if self._curve(member) is not None]

    def _sorted(self) -> list[Member]:
        """By task, then search, then seed, each in the order in which the suite names them."""
        orders = [list(dict.fromkeys(member.key[part] for member in self.members)) for part in range(3)]
        return sorted(self.members, key=lambda member: tuple(map(list.index, orders, member.key)))

    def _curve(self, member: Member) -> list[tuple[int, int, float]] | None:
        """The curve of a member; of one that is done it is read once, as its archive does not change any more."""
        if member.curve is not None:
            return member.curve
        try:
            (found,) = read_members([member.folder])
        except RunError:  # no archive yet, or one that is damaged, which its member reports
            return None
        curve = rises(found)
        member.curve = curve if member.state == DONE else None
        return curve


def rises(member: SearchResult) -> list[tuple[int, int, float]]:
    """``(evaluations, control steps, best fitness so far)`` wherever the best rises, and at the end."""
    points = zip(member.evaluations.tolist(), member.steps.tolist(), member.best.tolist(), strict=True)
    kept = []
    for point in points:
        if not kept or point[2] > kept[-1][2] or point[0] == member.evaluated:
            kept.append(point)
    return kept
