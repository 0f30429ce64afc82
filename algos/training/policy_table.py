"""Mean returns of trained policies, with confidence intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from warpvox.algos.evaluate import evaluate
from warpvox.algos.statistics import Interval, mean_interval
from warpvox.algos.training.loading import load_run
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.runs import Run


@dataclass(frozen=True)
class EvaluatedPolicy:
    """A row: the returns of all episodes, and of those that are independent; 1 where all are the same episode."""

    name: str
    task: str
    returns: list[float]
    independent: list[float]
    level: float

    @classmethod
    def of(cls, name: str, env: VoxelVecEnv, policy: Any, level: float, drawn: bool = False) -> EvaluatedPolicy:
        """The row of one episode in each environment; ``drawn``: they differ by chance in any case."""
        found = evaluate(env, policy)
        returns = found.returns.tolist()
        independent = returns if drawn or env.spec.is_random else [found.mean_return]
        return cls(name, env.spec.id, returns, independent, level)

    @property
    def interval(self) -> Interval:
        """Student's interval of the mean return."""
        return mean_interval(self.independent, self.level)

    @property
    def mean(self) -> float:
        """The mean return."""
        return self.interval.mean


@dataclass(frozen=True)
class PolicyTable(Sequence):
    """Rows in the order in which policies were given; printed as a table."""

    rows: list[EvaluatedPolicy]

    def __getitem__(self, number: Any) -> Any:
        return self.rows[number]

    def __len__(self) -> int:
        return len(self.rows)

    def _cells(self) -> Iterator[tuple[str, ...]]:
        yield "policy", "task", "mean return", f"{100 * self.rows[0].level:g} % interval", "episodes"
        for row in self.rows:
            low, high, n = row.interval.low, row.interval.high, row.interval.n
            yield row.name, row.task, f"{row.mean:.3f}", f"{low:.3f} to {high:.3f}" if n > 1 else "-", str(n)

    def _repr_html_(self) -> str:
        lines = ("".join(f"<td>{escape(cell)}</td>" for cell in line) for line in self._cells())
        return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"

    def __repr__(self) -> str:
        cells = list(self._cells())
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        return "\n".join("  ".join(map(str.ljust, line, widths)).rstrip() for line in cells)


def evaluate_run(run: Run, config: Any, designs: Any = None, level: float = 0.95) -> EvaluatedPolicy:
    """One episode in each environment of a run.

    Args:
        config, designs: see :func:`warpvox.algos.training.loading.load_run`.
        level: of the interval.
    """
    env, policy = load_run(run, config, designs, every=True)
    return EvaluatedPolicy.of(str(run.folder), env, policy, level, config.stochastic or run.is_many)
