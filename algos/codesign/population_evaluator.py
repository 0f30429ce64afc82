"""Evaluation of designs by training one policy each, all in one batch."""

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
    """Evaluator that trains one policy per candidate in one batch; fitness is the best evaluation.

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
        """Train the candidates and return their outcomes; out-of-memory errors say what to reduce."""
        count = len(candidates)
        half = -(-count // 2)
        fewer = f"batch={half} trains {half} designs at once instead of {count}; " if count > 1 else ""
        hint = (
            f"Take less at once: {fewer}training.envs is {self.settings.envs}, training.ppo.steps"
            f" {self.settings.ppo.steps}."
        )
        with enough_memory(hint):
            return self._train(candidates, parents, report)

    def _train(self, candidates: Sequence[Candidate], parents: Parents, report: Report) -> list[Outcome]:
        """Train and evaluate the candidates, dropping the worst at each rung of successive halving."""
        settings = self.settings
        outcomes = [Outcome(-math.inf) for _ in candidates]
        active = list(range(len(candidates)))  # candidates that are trained, in the order of the batch

        def inherit(design: int, env: VoxelVecEnv, networks: Networks) -> None:
            parent = best_parent(candidates[design], parents)
            if parent is not None:
                inherit_policy(self.factory, parent, env, design, networks)

        def keep(places: list[int]) -> None:
            """Stop all candidates except those at ``places`` in the batch."""
            nonlocal active
            if len(places) == len(active):
                return
            for place, k in enumerate(active):
                outcomes[k].stopped = place not in places
            active = [active[place] for place in places]
            if active:
                training.keep(places)

        training = PopulationTraining(
            self.factory,
            [candidate.body for candidate in candidates],
            [candidate_seed(self.seed, candidate.id) for candidate in candidates],
            settings,
            inherit if settings.inherit else None,
            self.seed,
        )
        halvings = settings.halvings()
        while active and training.iteration < settings.iterations:
            # Learn. Designs whose learning has diverged are stopped.
            training.iterate()
            done = training.iteration
            for k in active:
                outcomes[k].steps = done * training.steps_per_iteration
            keep([place for place, healthy in enumerate(training.algorithm.healthy().tolist()) if healthy])

            # Evaluate, when it is time
            if active and (done % settings.eval_interval == 0 or done == settings.iterations or done in halvings):
                values = training.evaluate().tolist()
                for place, value in enumerate(values):
                    outcome = outcomes[active[place]]
                    if math.isfinite(value):
                        outcome.curve.append((outcome.steps, value))
                    if value > outcome.fitness:
                        outcome.fitness = value
                        outcome.policy = training.policy(place)
                keep([place for place, value in enumerate(values) if math.isfinite(value)])

                # Halve: the worst are stopped, of equals those that were proposed last.
                if done in halvings:
                    ranked = sorted(range(len(active)), key=lambda place: -outcomes[active[place]].fitness)
                    keep(sorted(ranked[: settings.kept(len(active))]))

            if report is not None:
                finished = done == settings.iterations
                report(
                    {
                        "iteration": done,
                        "iterations": settings.iterations,
                        "steps": sum(outcome.steps for outcome in outcomes),
                        "best": [outcome.fitness if outcome.curve else math.nan for outcome in outcomes],
                        "training": [k in active and not finished for k in range(len(candidates))],
                    }
                )
        return outcomes


def best_parent(candidate: Candidate, parents: Parents) -> Parent | None:
    """Return the fittest parent of ``candidate`` in ``parents``, the first one in ties, or None."""
    known = [parents[number] for number in candidate.parents if number in parents]
    return max(known, key=lambda parent: parent.fitness, default=None)


def inherit_policy(factory: EnvFactory, parent: Parent, env: VoxelVecEnv, design: int, networks: Any) -> None:
    """Initialise the networks of a design in ``env`` from its parent's policy."""
    old = BodyLayout.of(factory.make([parent.body], 1, [0], auto_reset=False), 0)
    copy_weights(networks.actor, networks.critic, BodyLayout.of(env, design), old, parent.policy)
