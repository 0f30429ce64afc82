"""The best returns that are known of each task with bodies of 5 x 5 cells, and what chance reaches: to compare with."""

import csv
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

FILE = "known_returns.csv"


@dataclass(frozen=True)
class KnownReturn:
    """Known returns of a task.

    Attributes:
        task: its id.
        random: mean return of random bodies under random actions, measured by ``python docs/results.py random``.
        best: the best published return, None if there is none.
        method: who found it.
        source: where the number is found.
        protocol: how it was found, as far as the source says.
        note: what else to know about it.
    """

    task: str
    random: float
    best: float | None
    method: str
    source: str
    protocol: str
    note: str

    def score(self, value: float) -> float:
        """``(value - random) / (best - random)``: 0 is chance, 1 the best published return.

        Raises:
            ValueError: no return is published.
        """
        if self.best is None:
            raise ValueError(f"No return of {self.task} is published.")
        return (value - self.random) / (self.best - self.random)


@cache
def known_returns() -> dict[str, KnownReturn]:
    """By the id of the task; tasks of the benchmark only."""
    text = files("warpvox.envs").joinpath(FILE).read_text(encoding="utf-8")
    rows: list[dict[str, Any]] = list(csv.DictReader(text.splitlines()))
    for row in rows:
        row |= {"random": float(row["random"]), "best": float(row["best"]) if row["best"] else None}
    return {row["task"]: KnownReturn(**row) for row in rows}
