"""Evaluated runs with the same settings, side by side: their mean returns, differences, and tables of both."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from warpvox.algos.protocols import DISTURBANCES
from warpvox.algos.report.learning_curves import Group
from warpvox.algos.statistics import Interval, difference, mean_interval
from warpvox.algos.training.policy_table import EvaluatedPolicy
from warpvox.runs import Run


@dataclass(frozen=True)
class Judged:
    """Runs with the same settings, and what each has got in episodes of one disturbance."""

    group: Group
    rows: list[EvaluatedPolicy]

    @property
    def disturbance(self) -> str:
        """That of the episodes."""
        return self.rows[0].disturbance

    @property
    def over(self) -> str:
        """Sample of an interval: runs where there are several, else the episodes of the only one."""
        return "runs" if len(self.rows) > 1 else "episodes"

    @property
    def values(self) -> list[float]:
        """Independent values: the mean return of each run, or the returns of the only one."""
        return [row.mean for row in self.rows] if len(self.rows) > 1 else self.rows[0].independent


def judged_groups(groups: Iterable[Group], rows_of: Callable[[Run], Sequence[EvaluatedPolicy]]) -> list[Judged]:
    """Each group in each disturbance that all of its runs have been evaluated under, in the order of both."""
    found = []
    for group in groups:
        by_part = [{row.disturbance: row for row in rows_of(run)} for run in group.runs]
        shared = [part for part in DISTURBANCES if all(part in rows for rows in by_part)]
        found += [Judged(group, [rows[part] for rows in by_part]) for part in shared]
    return found


def compare(judged: Sequence[Judged], level: float) -> list[tuple[Judged, Judged, Interval]]:
    """Differences of mean returns on one task under one disturbance, first less second, with Welch's interval."""
    pairs = [
        (first, second)
        for first, second in combinations(judged, 2)
        if (first.rows[0].task, first.disturbance) == (second.rows[0].task, second.disturbance)
    ]
    return [(first, second, difference(first.values, second.values, level)) for first, second in pairs]


def tables(judged: Sequence[Judged], level: float) -> dict[str, list[dict[str, Any]]]:
    """``runs``, ``groups`` and ``comparisons``, as rows."""
    runs, groups, pairs = [], [], []
    for entry in judged:
        settings, episodes = {"settings": entry.group.label}, {"episodes": entry.disturbance}
        for run, one in zip(entry.group.runs, entry.rows, strict=True):
            found = {"quantile_10": one.low_tenth, "returns": one.returns}
            which = {"run": str(run.folder), "seed": run.config.get("seed")}
            runs.append(settings | which | episodes | _row(one.interval) | found)
        groups.append(settings | episodes | {"over": entry.over} | _row(mean_interval(entry.values, level)))
    for first, second, interval in compare(judged, level):
        names = {"first": first.group.label, "second": second.group.label, "episodes": first.disturbance}
        pairs.append(names | {"over": f"{first.over}, {second.over}"} | _row(interval, "difference"))
    return {"runs": runs, "groups": groups, "comparisons": pairs}


def _row(interval: Interval, name: str = "mean") -> dict[str, Any]:
    low, high = ((value if math.isfinite(value) else None) for value in (interval.low, interval.high))
    return {name: interval.mean, "low": low, "high": high, "n": interval.n}
