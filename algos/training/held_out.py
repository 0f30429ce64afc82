"""Evaluation of a policy on many bodies, written to a run's folder as table and picture."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpvox.design import Design
from warpvox.envs.registry import known_returns
from warpvox.io.reading import Unreadable, read_table
from warpvox.io.writing import write_table

if TYPE_CHECKING:
    from warpvox.algos.evaluate import EpisodeReturns, Evaluator

COLUMNS = "body", "last_return", "best_return", "cells"


def shades(task: str, returns: np.ndarray) -> list[float]:
    """Scale returns to [0, 1]: 0 for random actions or worse, 1 for the best published return or better.

    If no return is published for the task, 0 stands for a return of 0 or less, 1 for the largest absolute value in
    ``returns``.
    """
    known = known_returns().get(task)
    if known is None or known.best is None:
        return (returns.clip(min=0) / max(np.abs(returns).max(), 1e-9)).tolist()
    return np.clip((returns - known.random) / (known.best - known.random), 0, 1).tolist()


class HeldOut:
    """Evaluator of a policy on many bodies; writes the return on each body to a table and a picture.

    The files are ``<name>.csv`` and ``<name>.png`` in ``folder``, the run's folder; None: nothing is written.
    """

    def __init__(self, judge: Evaluator, bodies: Sequence[Design], name: str = "held_out", task: str = "") -> None:
        """Set up the evaluation; ``folder`` is assigned once the run has one.

        Args:
            judge: evaluates a policy in environments with the ``bodies``.
            name: of both files, without suffix.
            task: by which returns are scaled for the picture.
        """
        self.judge = judge
        self.bodies = list(bodies)
        self.name = name
        self.task = task
        self.folder: Path | None = None

    @property
    def about(self) -> str:
        """Number of bodies, as text, and whether the policy is trained on them."""
        count = f"{len(self.bodies)} bod{'y' if len(self.bodies) == 1 else 'ies'}"
        return f"the {count} trained on" if self.name == "bodies" else f"{count} held out from training"

    def __call__(self, policy: Any) -> EpisodeReturns:
        """Evaluate ``policy`` and return the result; writes table and picture if there is a folder."""
        result = self.judge(policy)
        last = result.fitness.numpy()
        if self.folder is not None:
            file = self.folder / f"{self.name}.csv"
            cells = ["/".join("".join(map(str, row)) for row in body.tolist()) for body in self.bodies]
            figures = [[f"{value:.6g}" for value in values] for values in (last, np.maximum(last, self._best(file)))]
            write_table(file, COLUMNS, zip(range(len(cells)), *figures, cells, strict=True))
            self._draw(last, self.folder / f"{self.name}.png")
        return result

    def _best(self, file: Path) -> np.ndarray:
        """Read the best return on each body so far, ``[bodies]``, from the table; -inf if there is none."""
        with suppress(Unreadable, KeyError, TypeError, ValueError):  # of a file that somebody else has written
            best = np.array([row["best_return"] for row in read_table(file)], float)
            if len(best) == len(self.bodies):
                return best
        return np.full(len(self.bodies), -np.inf)

    def _draw(self, last: np.ndarray, file: Path) -> None:
        """Save a picture of the bodies, best first, with greener backgrounds for higher returns."""
        from warpvox.view.body_picture import draw_bodies
        from warpvox.view.painter import save_png

        order = np.argsort(-last, kind="stable")
        low, middle, high = np.quantile(last, (0.1, 0.5, 0.9))
        title = f"{self.about}: mean {last.mean():.2f}, quantiles 10, 50, 90 %: {low:.2f}, {middle:.2f}, {high:.2f}"
        picture = draw_bodies(
            [self.bodies[number] for number in order],
            [(f"{last[number]:.2f}", f"body {number}") for number in order],
            title,
            cell=20,
            shades=shades(self.task, last[order]),
            columns=8,
        )
        save_png(picture, file)
