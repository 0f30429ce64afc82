"""Evaluation of a generation of designs in one batch."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from warpvox.algos.candidate import Candidate, Outcome, Parent, Parents, Report, candidate_seed
from warpvox.algos.codesign.inheritance import BodyLayout, copy_weights
from warpvox.algos.env_factory import EnvFactory
from warpvox.algos.population.training import Networks, PopulationTraining
from warpvox.algos.settings import DesignTraining
from warpvox.devices.out_of_memory import enough_memory
from warpvox.envs.vec_env import VoxelVecEnv


@dataclass(frozen=True)
class PopulationEvaluator:
    """Trains all candidates in one batch; fitness is the best of their deterministic evaluations.

    With ``settings.rungs`` the worst candidates are stopped early (successive halving). A candidate whose learning
    diverges is stopped too, with the fitness it had reached (-inf: none).

    Attributes:
        settings: without those of ``ppo`` for rsl-rl alone.
        seed: of the experiment; all designs are evaluated in the episodes of this seed.
    """

    factory: EnvFactory
    settings: DesignTraining
    seed: int = 0

    def evaluate(self, candidates: Sequence[Candidate], parents: Parents, report: Report = None) -> list[Outcome]:
        with enough_memory(memory_hint(self.settings, len(candidates))):
            generation = _Generation(self, candidates, parents)
            while generation.active and generation.training.iteration < self.settings.iterations:
                generation.advance()
                if report is not None:
                    report(generation.progress())
        return generation.outcomes


class _Generation:
    """The state of an evaluation."""

    def __init__(self, evaluator: PopulationEvaluator, candidates: Sequence[Candidate], parents: Parents) -> None:
        self.factory = evaluator.factory
        self.settings = evaluator.settings
        self.seed = evaluator.seed
        self.candidates = list(candidates)
        self.parents = parents
        self.seeds = [candidate_seed(evaluator.seed, candidate.id) for candidate in candidates]
        self.outcomes = [Outcome(-math.inf) for _ in candidates]
        self.halvings = self.settings.halvings()
        self.active = list(range(len(candidates)))
        bodies = [candidate.body for candidate in candidates]
        inherit = self._inherit if self.settings.inherit else None
        self.training = PopulationTraining(self.factory, bodies, self.seeds, self.settings, inherit, self.seed)

    def _inherit(self, design: int, env: VoxelVecEnv, networks: Networks) -> None:
        parent = best_parent(self.candidates[self.active[design]], self.parents)
        if parent is not None:
            inherit_policy(self.factory, parent, env, design, networks)

    def advance(self) -> None:
        """One iteration, then evaluation and halving as scheduled."""
        self.training.iterate()
        for k in self.active:
            self.outcomes[k].steps = self.training.iteration * self.training.steps_per_iteration
        self._keep([place for place, well in enumerate(self.training.algorithm.healthy().tolist()) if well])
        done, end = self.training.iteration, self.settings.iterations
        if self.active and (done % self.settings.eval_interval == 0 or done == end or done in self.halvings):
            self._evaluate()
            if done in self.halvings:
                self._halve()

    def _evaluate(self) -> None:
        values = self.training.evaluate().tolist()
        for place, (k, value) in enumerate(zip(self.active, values, strict=True)):
            outcome = self.outcomes[k]
            if math.isfinite(value):
                outcome.curve.append((outcome.steps, value))
            if value > outcome.fitness:
                outcome.fitness, outcome.policy = value, self.training.policy(place)
        self._keep([place for place, value in enumerate(values) if math.isfinite(value)])

    def _halve(self) -> None:
        """Stop the worst; of equals, those that were proposed last."""
        count = self.settings.kept(len(self.active))
        ranked = sorted(range(len(self.active)), key=lambda place: -self.outcomes[self.active[place]].fitness)
        self._keep(sorted(ranked[:count]))

    def _keep(self, places: list[int]) -> None:
        if len(places) == len(self.active):
            return
        for place, k in enumerate(self.active):
            self.outcomes[k].stopped = place not in places
        self.active = [self.active[place] for place in places]
        if self.active:
            self.training.keep(places)

    def progress(self) -> dict[str, Any]:
        """The content of a report, see :data:`warpvox.algos.candidate.Report`."""
        finished = self.training.iteration == self.settings.iterations
        return {
            "iteration": self.training.iteration,
            "iterations": self.settings.iterations,
            "steps": sum(outcome.steps for outcome in self.outcomes),
            "best": [outcome.fitness if outcome.curve else math.nan for outcome in self.outcomes],
            "training": [k in self.active and not finished for k in range(len(self.candidates))],
        }


def memory_hint(settings: DesignTraining, count: int) -> str:
    """Advice for when the training of ``count`` designs takes too much memory."""
    fewer = f"batch={-(-count // 2)} trains {-(-count // 2)} designs at once instead of {count}; " if count > 1 else ""
    return f"Take less at once: {fewer}training.envs is {settings.envs}, training.ppo.steps {settings.ppo.steps}."


def best_parent(candidate: Candidate, parents: Parents) -> Parent | None:
    """The fittest of a candidate's known parents; of equals the first."""
    known = [parents[number] for number in candidate.parents if number in parents]
    return max(known, key=lambda parent: parent.fitness, default=None)


def inherit_policy(factory: EnvFactory, parent: Parent, env: VoxelVecEnv, design: int, networks: Any) -> None:
    """Initialise ``networks.actor`` and ``networks.critic`` of a design of ``env`` with the parent's policy."""
    old = BodyLayout.of(factory.make([parent.body], 1, [0], auto_reset=False), 0)
    copy_weights(networks.actor, networks.critic, BodyLayout.of(env, design), old, parent.policy)
