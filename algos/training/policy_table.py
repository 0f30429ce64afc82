"""Mean returns of trained policies, with confidence intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from warpvox.algos.disturbance import Disturbed
from warpvox.algos.evaluate import evaluate
from warpvox.algos.protocols import NOMINAL
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
    disturbance: str = NOMINAL

    @classmethod
    def each(
        cls,
        name: str,
        env: VoxelVecEnv,
        policy: Any,
        level: float,
        parts: Sequence[str] = (NOMINAL,),
        drawn: bool = False,
    ) -> list[EvaluatedPolicy]:
        """A row of each disturbance, after one episode in each environment; ``drawn``: all of them differ by chance."""
        found = evaluate(env, policy)
        designs = int(found.design_index.max()) + 1
        blocks = found.returns.view(designs, len(parts), -1).transpose(0, 1).flatten(1)
        rows = []
        for part, returns in zip(parts, blocks.tolist(), strict=True):
            differ = drawn or part != NOMINAL or env.spec.is_random
            independent = returns if differ else [sum(returns) / len(returns)]
            rows.append(cls(name, env.spec.id, returns, independent, level, part))
        return rows

    @property
    def interval(self) -> Interval:
        """Student's interval of the mean return."""
        return mean_interval(self.independent, self.level)

    @property
    def mean(self) -> float:
        """The mean return."""
        return self.interval.mean

    @property
    def low_tenth(self) -> float:
        """The 10 % quantile of the returns."""
        return float(np.quantile(self.independent, 0.1))


@dataclass(frozen=True)
class PolicyTable(Sequence):
    """Rows in the order in which policies were given; printed as a table."""

    rows: list[EvaluatedPolicy]

    def __getitem__(self, number: Any) -> Any:
        return self.rows[number]

    def __len__(self) -> int:
        return len(self.rows)

    def _cells(self) -> Iterator[tuple[str, ...]]:
        percent = f"{100 * self.rows[0].level:g} % interval"
        yield "policy", "task", "episodes", "mean return", percent, "10 % quantile", "n"
        for row in self.rows:
            low, high, n = row.interval.low, row.interval.high, row.interval.n
            interval = f"{low:.3f} to {high:.3f}" if n > 1 else "-"
            yield row.name, row.task, row.disturbance, f"{row.mean:.3f}", interval, f"{row.low_tenth:.3f}", str(n)

    def _repr_html_(self) -> str:
        lines = ("".join(f"<td>{escape(cell)}</td>" for cell in line) for line in self._cells())
        return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"

    def __repr__(self) -> str:
        cells = list(self._cells())
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        return "\n".join("  ".join(map(str.ljust, line, widths)).rstrip() for line in cells)


def evaluate_run(run: Run, config: Any, designs: Any = None, level: float = 0.95) -> list[EvaluatedPolicy]:
    """One episode in each environment of a run: a row of each disturbance of the protocol.

    Args:
        config, designs: see :func:`warpvox.algos.training.loading.load_run`.
        level: of the interval.
    """
    env, policy = load_run(run, config, designs, every=True)
    parts = policy.parts if isinstance(policy, Disturbed) else (NOMINAL,)
    return EvaluatedPolicy.each(str(run.folder), env, policy, level, parts, config.stochastic or run.is_many)
