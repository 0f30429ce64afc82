"""Fitness by training a policy for each design."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from warpvox.algos.codesign.settings import Codesign, Fitness, Workload, register_fitness
from warpvox.algos.protocols import episodes_of
from warpvox.errors import ConfigError
from warpvox.keys import key

if TYPE_CHECKING:
    from warpvox.algos.candidate import DesignEvaluator
    from warpvox.envs.spec import TaskSpec


@register_fitness
@dataclass
class Specialist(Fitness):
    """Fitness by training: the best return of a policy trained for one design (paper section C.1)."""

    name: str = key("specialist", "each design has a policy of its own", choices=("specialist",))

    def check(self, search: Codesign) -> None:
        """Raise an error unless the PPO settings suit training many designs in one batch."""
        from warpvox.algos.ppo.stock import rsl_rl_config

        training = search.training
        training.ppo.check(training.envs, "training.ppo")
        if training.ppo.rnn is not None or training.ppo.extra:
            raise ConfigError(
                "training.ppo.rnn and training.ppo.extra are for one policy: a search trains its designs side by side."
            )
        rsl_rl_config(training.ppo, 1)  # raises for settings that do not fit together

    def inherits(self, search: Codesign) -> bool:
        return search.training.inherit

    def cost(self, search: Codesign, task: TaskSpec) -> tuple[float, float]:
        return search.training.steps_of_design(search.search.population), 0

    def workloads(self, search: Codesign) -> list[Workload]:
        """Return the sizes of the largest simulated batches, for memory estimates."""
        training = search.training
        count = self.finalists or search.search.population
        together = min(search.batch or count, count)
        judged = episodes_of(training.episodes, search.protocol)
        return [
            Workload(together, training.envs, "training.envs", training.envs, ppo=training.ppo),
            Workload(together, judged, "training.episodes", judged),
        ]

    def build(self, search: Codesign, known: Any) -> DesignEvaluator:
        from warpvox.algos.codesign.population_evaluator import PopulationEvaluator

        return PopulationEvaluator(search.factory(), search.training, search.seed)
