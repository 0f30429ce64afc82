"""Mean returns of trained policies, with confidence intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from warpvox.algos.evaluate import Evaluation, draws_at_random, evaluate
from warpvox.algos.statistics import Interval, mean_interval
from warpvox.algos.training.loading import load_run
from warpvox.runs import Run

__all__ = ["EvaluatedPolicy", "PolicyTable", "evaluate_run"]


@dataclass(frozen=True)
class EvaluatedPolicy:
    """A row: the returns of all episodes, and Student's interval of their mean.

    The interval has no width where the task draws nothing at random and the policy is deterministic: all episodes are
    the same one.
    """

    name: str
    task: str
    returns: list[float]
    interval: Interval

    @classmethod
    def of(cls, name: str, task: str, found: Evaluation, drawn: bool, level: float) -> EvaluatedPolicy:
        """The row of an evaluation; ``drawn``: whether its episodes differ by chance."""
        returns = found.returns.tolist()
        return cls(name, task, returns, mean_interval(returns if drawn else [found.mean_return], level))

    @property
    def mean(self) -> float:
        """The mean return."""
        return self.interval.mean


@dataclass(frozen=True)
class PolicyTable(Sequence):
    """Rows in the order in which policies were given; printed as a table. ``level``: of the intervals."""

    rows: list[EvaluatedPolicy]
    level: float

    def __getitem__(self, number: Any) -> Any:
        return self.rows[number]

    def __len__(self) -> int:
        return len(self.rows)

    def _cells(self) -> Iterator[tuple[str, ...]]:
        yield "policy", "task", "mean return", f"{100 * self.level:g} % interval", "episodes"
        for row in self.rows:
            low, high, n = row.interval.low, row.interval.high, row.interval.n
            yield row.name, row.task, f"{row.mean:.3f}", f"{low:.3f} to {high:.3f}" if n > 1 else "-", str(n)

    def __repr__(self) -> str:
        cells = list(self._cells())
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        return "\n".join("  ".join(map(str.ljust, line, widths)).rstrip() for line in cells)


def evaluate_run(run: Run, config: Any, designs: Any = None) -> tuple[Evaluation, bool]:
    """One episode in each environment of a run, and whether they differ by chance.

    Args:
        config, designs: see :func:`warpvox.algos.training.loading.load_run`.
    """
    env, policy = load_run(run, config, designs, every=True)
    found = evaluate(env, policy)
    return found, config.stochastic or run.is_many or draws_at_random(env)
