"""Designs are compared without a training for each, and the best of all get one at the end of the search."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpvox.algos.codesign.evaluations.base import (
    Evaluation,
    Workload,
    check_training,
    training_evaluator,
    training_workload,
    try_network,
)
from warpvox.errors import ConfigError
from warpvox.keys import key

if TYPE_CHECKING:
    from warpvox.algos.candidate import DesignEvaluator
    from warpvox.algos.codesign.settings import Codesign

__all__ = ["Screened"]


@dataclass
class Screened(Evaluation):
    """The base of evaluations with finalists: :meth:`screening` is for all designs, :meth:`final` for the best."""

    finalists: int = key(4, "number of best designs that get a training of their own at the end", low=1)

    def screening(self, search: Codesign, known: Any) -> DesignEvaluator:
        """The evaluator of all designs but the finalists."""
        raise NotImplementedError

    def final(self, search: Codesign, known: Any) -> DesignEvaluator:
        """The evaluator of the finalists."""
        return training_evaluator(search)

    def build(self, search: Codesign, known: Any) -> DesignEvaluator:
        from warpvox.algos.codesign.finalists import TwoStages

        return TwoStages(self.screening(search, known), self.final(search, known))

    def check(self, search: Codesign) -> None:
        check_training(search)
        if search.training.inherit:
            raise ConfigError(
                f"training.inherit does not go with evaluation={self.name}: the trainings of the finalists begin with"
                " new networks."
            )

    def resolved(self, search: Codesign, folder: Path | None) -> Evaluation:
        try_network(search)
        return self

    def workloads(self, search: Codesign) -> list[Workload]:
        return [training_workload(search, self.finalists)]
