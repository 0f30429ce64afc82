"""Each design is judged by a policy of its own, or only the best of those that are compared in another way."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpvox.algos.codesign.evaluations.base import Evaluation, Workload, probe, steps_of_training
from warpvox.algos.protocols import episodes_of
from warpvox.algos.settings import MLP
from warpvox.errors import ConfigError
from warpvox.keys import key

if TYPE_CHECKING:
    from warpvox.algos.candidate import DesignEvaluator
    from warpvox.algos.codesign.settings import Codesign
    from warpvox.envs.spec import TaskSpec


@dataclass
class Specialist(Evaluation):
    """The fitness of a design is the best return of a policy that is trained for it alone (paper section C.1)."""

    name: str = key("specialist", "each design has a policy of its own", choices=("specialist",))

    def check(self, search: Codesign) -> None:
        from warpvox.algos.policies.registry import check_policy
        from warpvox.algos.training.ppo import rsl_rl_config

        training = search.training
        training.ppo.check(training.envs, "training.ppo")
        check_policy(search.policy)
        if training.method == "sequential" and training.rungs:
            raise ConfigError("training.rungs needs training.method=population: designs must be trained side by side.")
        if search.policy == MLP and search.network is not None:
            raise ConfigError(
                "network has the settings of policy=grid, transformer or your own; mlp has training.ppo.hidden."
            )
        if search.policy != MLP and training.method != "sequential":
            raise ConfigError(
                f"policy={search.policy} needs training.method=sequential: designs that are trained side by side have"
                " fully connected layers (policy=mlp)."
            )
        if training.method != "sequential" and (training.ppo.rnn is not None or training.ppo.extra):
            raise ConfigError("training.ppo.rnn and training.ppo.extra need training.method=sequential.")
        if training.inherit and training.ppo.rnn is not None:
            raise ConfigError("training.inherit does not go with training.ppo.rnn: recurrent layers are not inherited.")
        rsl_rl_config(training.ppo, 1, None if search.policy == MLP else {})  # whose settings it knows

    def resolved(self, search: Codesign, folder: Path | None) -> Evaluation:
        from warpvox.algos.policies.registry import check_network

        if search.policy != MLP:
            check_network(probe(search.factory("voxel"), search.shape), search.policy, search.network, "network")
        return self

    def inherits(self, search: Codesign) -> bool:
        return search.training.inherit

    def cost(self, search: Codesign, task: TaskSpec) -> tuple[float, float]:
        return steps_of_training(search.training, search.search.population), 0

    def workloads(self, search: Codesign) -> list[Workload]:
        """The batch of the trainings of a generation, or of the finalists where they alone have some."""
        training, count = search.training, self.finalists or search.search.population
        together = 1 if training.method == "sequential" else min(search.batch or count, count)
        obs = "task" if search.policy == MLP else "voxel"
        learning = Workload(together, training.envs, "training.envs", training.envs, obs, training.ppo)
        judged = episodes_of(training.eval_envs, search.fitness)
        return [learning, Workload(together, judged, "training.eval_envs", judged, obs)]

    def build(self, search: Codesign, known: Any) -> DesignEvaluator:
        from warpvox.algos.codesign.population_evaluator import PopulationEvaluator
        from warpvox.algos.codesign.sequential_evaluator import SequentialEvaluator

        if search.training.method == "population":
            return PopulationEvaluator(search.factory(), search.training, search.seed)
        if search.policy == MLP:
            return SequentialEvaluator(search.factory(), search.training, search.seed)
        network = search.policy, dict(search.network or {})
        return SequentialEvaluator(search.factory("voxel"), search.training, search.seed, *network)


@dataclass
class Screened(Specialist):
    """The base of evaluations with finalists: :meth:`screening` is for all designs, :meth:`final` for the best."""

    finalists: int = key(4, "number of best designs that get a training of their own at the end", low=1)

    def screening(self, search: Codesign, known: Any) -> DesignEvaluator:
        raise NotImplementedError

    def final(self, search: Codesign, known: Any) -> DesignEvaluator:
        return super().build(search, known)

    def build(self, search: Codesign, known: Any) -> DesignEvaluator:
        from warpvox.algos.codesign.finalists import TwoStages

        return TwoStages(self.screening(search, known), self.final(search, known))

    def check(self, search: Codesign) -> None:
        super().check(search)
        if search.training.inherit:
            raise ConfigError(
                f"training.inherit does not go with evaluation={self.name}: the trainings of the finalists begin with"
                " new networks."
            )
