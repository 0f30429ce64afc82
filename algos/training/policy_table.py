"""Tables of mean returns with confidence intervals, and comparisons of groups of runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from itertools import combinations
from typing import Any

import numpy as np

from warpvox.algos.disturbance import Disturbed
from warpvox.algos.evaluate import evaluate
from warpvox.algos.protocols import DISTURBANCES, NOMINAL
from warpvox.algos.report.learning_curves import Group
from warpvox.algos.statistics import Interval, difference, mean_interval
from warpvox.algos.training.loading import load_run
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.runs import Run


@dataclass(frozen=True)
class EvaluatedPolicy:
    """A row of the table: a policy's returns under one disturbance.

    ``returns`` are those of all episodes; ``independent`` is the sample that the interval is computed from: with
    several bodies, or episodes that are all equal, one mean for each body, else ``returns``. ``drawn``: episodes with
    the same body differ by chance.
    """

    name: str
    task: str
    returns: list[float]
    independent: list[float]
    level: float
    disturbance: str
    drawn: bool

    @classmethod
    def each(
        cls, name: str, env: VoxelVecEnv, policy: Any, level: float, parts: Sequence[str], drawn: bool
    ) -> list[EvaluatedPolicy]:
        """Run one episode in each environment; return a row per disturbance in ``parts``."""
        blocks = evaluate(env, policy).returns.view(env.num_designs, len(parts), -1).transpose(0, 1)
        rows = []
        for part, block in zip(parts, blocks.tolist(), strict=True):
            returns = [value for body in block for value in body]
            differ = drawn or part != NOMINAL or env.spec.is_random
            independent = returns if differ and env.num_designs == 1 else [sum(body) / len(body) for body in block]
            rows.append(cls(name, env.spec.id, returns, independent, level, part, differ))
        return rows

    def __repr__(self) -> str:
        return f"EvaluatedPolicy({self.name}, {self.disturbance}, {self.episodes}, mean {self.mean:.3f})"

    @property
    def interval(self) -> Interval:
        """Confidence interval of the mean return (Student's t)."""
        return mean_interval(self.independent, self.level)

    @property
    def episodes(self) -> str:
        """Number of independent episodes, marked if repeating them changes nothing."""
        return str(len(self.returns)) if self.drawn else f"{len(self.independent)} (deterministic)"

    @property
    def mean(self) -> float:
        """Mean return."""
        return self.interval.mean

    @property
    def low_tenth(self) -> float:
        """10 % quantile of the independent returns."""
        return float(np.quantile(self.independent, 0.1))


class PolicyTable(tuple[EvaluatedPolicy, ...]):
    """List of evaluated policies, shown as a table by ``print`` and in notebooks."""

    def _cells(self) -> Iterator[tuple[str, ...]]:
        """Yield the header and each row as text."""
        yield "policy", "task", "protocol", "episodes", "mean", f"{100 * self[0].level:g} % CI", "10 % quantile"
        for row in self:
            low, high = row.interval.low, row.interval.high
            interval = f"{low:.3f} to {high:.3f}" if row.interval.n > 1 else ""
            mean, tenth = f"{row.mean:.3f}", f"{row.low_tenth:.3f}"
            yield row.name, row.task, row.disturbance, row.episodes, mean, interval, tenth

    def _repr_html_(self) -> str:
        lines = ("".join(f"<td>{escape(cell)}</td>" for cell in line) for line in self._cells())
        return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"

    def __repr__(self) -> str:
        cells = list(self._cells())
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        return "\n".join("  ".join(map(str.ljust, line, widths)).rstrip() for line in cells)


def evaluate_run(run: Run, config: Any, designs: Any = None, level: float = 0.95) -> list[EvaluatedPolicy]:
    """Run one episode in each environment of a run; return a row for each disturbance."""
    env, policy = load_run(run, config, designs, every=True)
    parts = policy.parts if isinstance(policy, Disturbed) else (NOMINAL,)
    return EvaluatedPolicy.each(str(run.folder), env, policy, level, parts, config.stochastic)


@dataclass(frozen=True)
class Judged:
    """A group of runs with the same settings, and their evaluations under one disturbance."""

    group: Group
    rows: list[EvaluatedPolicy]

    @property
    def disturbance(self) -> str:
        """Name of the disturbance."""
        return self.rows[0].disturbance

    @property
    def over(self) -> str:
        """Sample of the confidence interval: ``runs`` if there are several, else the ``episodes`` of one run."""
        return "runs" if len(self.rows) > 1 else "episodes"

    @property
    def values(self) -> list[float]:
        """Independent values: the mean return of each run, or the episodes' returns of a single run."""
        return [row.mean for row in self.rows] if len(self.rows) > 1 else self.rows[0].independent


def judged_groups(groups: Iterable[Group], rows_of: Callable[[Run], Sequence[EvaluatedPolicy]]) -> list[Judged]:
    """Combine rows into a :class:`Judged` per group and disturbance, if all runs of the group have it."""
    found = []
    for group in groups:
        by_part = [{row.disturbance: row for row in rows_of(run)} for run in group.runs]
        shared = [part for part in DISTURBANCES if all(part in rows for rows in by_part)]
        found += [Judged(group, [rows[part] for rows in by_part]) for part in shared]
    return found


def compare(judged: Sequence[Judged], level: float) -> list[tuple[Judged, Judged, Interval]]:
    """Compare all pairs with the same task and disturbance: Welch's interval of the difference in mean return."""
    pairs = [
        (first, second)
        for first, second in combinations(judged, 2)
        if (first.rows[0].task, first.disturbance) == (second.rows[0].task, second.disturbance)
    ]
    return [(first, second, difference(first.values, second.values, level)) for first, second in pairs]


def tables(judged: Sequence[Judged], level: float) -> dict[str, list[dict[str, Any]]]:
    """Build the tables ``runs``, ``groups`` and ``comparisons``, each as a list of rows."""
    runs = []
    groups = []
    pairs = []
    for entry in judged:
        settings = {"settings": entry.group.label}
        episodes = {"episodes": entry.disturbance}
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
    """Build the columns of an interval: the mean as ``name``, ``low``, ``high`` (None if not finite) and ``n``."""
    low, high = ((value if math.isfinite(value) else None) for value in (interval.low, interval.high))
    return {name: interval.mean, "low": low, "high": high, "n": interval.n}
