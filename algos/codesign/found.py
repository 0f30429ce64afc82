"""The result of a design search."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpvox.algos.codesign.archive import FILE as ARCHIVE, Archive, Record

if TYPE_CHECKING:
    from warpvox.algos.checkpoints.policy import Policy
    from warpvox.algos.codesign.settings import Codesign

SHOWN = 5
"""Designs that a notebook shows."""


@dataclass(frozen=True)
class Found:
    """A design search that has been made.

    Attributes:
        folder: its archive, policies and report; as ``warpvox play run=FOLDER`` takes it.
        settings: with what their names stood for.
        summary: what ``summary.json`` says: ``status``, ``evaluations``, ``steps``, ``best_fitness``, ...
    """

    folder: Path
    settings: Codesign
    summary: Mapping[str, Any]
    kept: Any = dataclasses.field(default=None, repr=False)

    @cached_property
    def designs(self) -> list[Record]:
        """All designs with a result, the best first: body, fitness, learning curve, ancestors."""
        with Archive.read(self.folder / ARCHIVE) as archive:
            return archive.best(max(1, archive.count()))

    @property
    def best(self) -> Record:
        """The best design."""
        return self.designs[0]

    @property
    def policy(self) -> Policy:
        """The policy of the best design, on the CPU; see :func:`warpvox.load_policy`."""
        return self.policy_of(self.best.id)

    def policy_of(self, design: int, device: str = "cpu") -> Policy:
        """The policy of a design, by its id."""
        from warpvox.algos.training.loading import load_policy

        return load_policy(self.folder / "designs" / str(design), device=device)

    @property
    def curve(self) -> dict[str, np.ndarray]:
        """``evaluations`` and ``steps`` spent, int64, and the ``best`` return by then, float64; ``[n]`` each."""
        from warpvox.algos.report.members import read_members

        (member,) = read_members([self.folder])
        return {name: getattr(member, name) for name in ("evaluations", "steps", "best")}

    @property
    def report(self) -> Path:
        """The page ``report.html``."""
        from warpvox.algos.report import FILE

        return self.folder / FILE

    def __repr__(self) -> str:
        best = f"best {self.summary['best_fitness']:.3f}" if self.summary["best_fitness"] is not None else "no result"
        where = repr(str(self.folder)) if self.kept is None else "in a temporary folder"
        return f"Found({self.settings.task}, {self.summary['evaluations']} designs, {best}, {where})"

    def _repr_html_(self) -> str:
        """The best bodies with their returns, and the curve, for notebooks."""
        from warpvox.algos.report.charts import picture
        from warpvox.view.palette import body_svg

        cells = "".join(
            f"<td>{body_svg(record.candidate.body, 16)}<br>{record.fitness:.3f} #{record.id}</td>"
            for record in self.designs[:SHOWN]
        )
        curve = self.curve
        points = list(zip(curve["evaluations"].tolist(), curve["best"].tolist(), strict=True))
        chart = picture(points, "designs", "best return", "step")
        return f"{escape(repr(self))}<table><tr>{cells}</tr></table>{chart}"
