"""Each design is judged by a policy of its own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpvox.algos.codesign.evaluations.base import (
    Evaluation,
    Workload,
    check_training,
    steps_of_training,
    training_evaluator,
    training_workload,
    try_network,
)
from warpvox.keys import key

if TYPE_CHECKING:
    from warpvox.algos.candidate import DesignEvaluator
    from warpvox.algos.codesign.settings import Codesign
    from warpvox.envs.spec import TaskSpec

__all__ = ["Specialist"]


@dataclass
class Specialist(Evaluation):
    """The fitness of a design is the best return of a policy that is trained for it alone (paper section C.1)."""

    name: str = key("specialist", "each design has a policy of its own", choices=("specialist",))

    def check(self, search: Codesign) -> None:
        check_training(search)

    def resolved(self, search: Codesign, folder: Path | None) -> Specialist:
        try_network(search)
        return self

    def inherits(self, search: Codesign) -> bool:
        return search.training.inherit

    def cost(self, search: Codesign, task: TaskSpec) -> tuple[float, float]:
        return steps_of_training(search.training, search.search.population), 0

    def workloads(self, search: Codesign) -> list[Workload]:
        return [training_workload(search, search.search.population)]

    def build(self, search: Codesign, known: Any) -> DesignEvaluator:
        return training_evaluator(search)
