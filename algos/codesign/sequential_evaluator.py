"""Evaluation of designs one after another, each with a training of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, cast

from warpvox.algos.candidate import Candidate, Outcome, Parent, Parents, Report, candidate_seed
from warpvox.algos.checkpoints.files import damaged, spec_dict
from warpvox.algos.codesign.inheritance import copy_voxel_policy
from warpvox.algos.codesign.population_evaluator import (
    AGAIN,
    best_parent,
    describe,
    inherit_policy,
    memory_hint,
    outcome_of,
    read_evaluation,
    save_evaluation,
)
from warpvox.algos.env_factory import EnvFactory
from warpvox.algos.evaluate import EpisodeReturns, evaluator
from warpvox.algos.generators import Generators
from warpvox.algos.policies.registry import voxels_of
from warpvox.algos.settings import DesignTraining
from warpvox.algos.training.runner import Runner, Schedule, adapt
from warpvox.devices.out_of_memory import enough_memory
from warpvox.errors import DivergenceError


@dataclass(frozen=True)
class SequentialEvaluator:
    """Trains candidate after candidate with :class:`warpvox.algos.training.runner.Runner`.

    Attributes as of :class:`warpvox.algos.codesign.population_evaluator.PopulationEvaluator`, and:
        network, network_settings: of policies for voxels (:mod:`warpvox.algos.policies.registry`), for which
            ``factory`` must make environments with ``obs="voxel"``; None: fully connected layers.
    """

    factory: EnvFactory
    settings: DesignTraining
    seed: int = 0
    network: str | None = None
    network_settings: Mapping[str, Any] = field(default_factory=dict)

    def evaluate(
        self, candidates: Sequence[Candidate], parents: Parents, report: Report = None, checkpoint: Path | None = None
    ) -> list[Outcome]:
        about = describe(self.factory, self.settings, self.seed, candidates)
        if self.network is not None:
            about |= {"network": self.network, "network_settings": dict(self.network_settings)}
        done = _Done(about, checkpoint)
        for candidate in candidates[len(done.outcomes) :]:
            with enough_memory(memory_hint(self.settings, 1)):
                outcome = self._train(candidate, best_parent(candidate, parents), done)
            done.add(outcome)
            if report is not None:
                report(self._progress(done.outcomes, len(candidates)))
        return done.outcomes

    def _train(self, candidate: Candidate, parent: Parent | None, done: _Done) -> Outcome:
        settings, seed = self.settings, candidate_seed(self.seed, candidate.id)
        outcome = done.outcome or Outcome(-math.inf)
        env = adapt(self.factory.make([candidate.body], settings.envs, [seed], auto_reset=True), settings.ppo)
        on_cpu = self.factory.computed(device="cpu")  # where few environments are faster
        episodes = self.factory.episodes(settings.eval_envs)
        judged = on_cpu.make([candidate.body], episodes, [seed], auto_reset=False)
        judge = evaluator(judged, [self.seed], self.factory.fitness)

        def evaluate(policy: Any) -> EpisodeReturns:
            result = judge(policy)
            value = float(result.fitness[0])
            outcome.curve.append((runner.steps, value))
            if value > outcome.fitness:
                outcome.fitness, outcome.spec = value, spec_dict(policy.spec)
                state = policy.actor.state_dict()
                outcome.policy = {name: tensor.detach().cpu().clone() for name, tensor in state.items()}
            return result

        def save() -> None:
            if runner.current_learning_iteration > 0:  # before that there is nothing to save
                done.save(outcome, runner.state())

        schedule = Schedule(settings.iterations, settings.save_interval, settings.eval_interval)
        voxels = None if self.network is None else voxels_of(self.network, env.env, self.network_settings)
        generators = Generators(seed, str(env.device))
        runner = Runner(
            env, settings.ppo, schedule, evaluator=evaluate, on_save=save, voxels=voxels, generators=generators
        )
        if done.training is not None:
            with damaged(done.file, AGAIN):
                runner.set_state(done.training)
        elif settings.inherit and parent is not None and self.network is not None:
            copy_voxel_policy(cast(Any, runner.alg.actor), parent.policy)
        elif settings.inherit and parent is not None:
            inherit_policy(self.factory, parent, env.env, 0, runner.alg)
        try:
            runner.run()
        except DivergenceError:  # it leaves with what it had, as one of many would
            outcome.stopped = True
            runner.current_learning_iteration += 1
        outcome.steps = runner.steps
        return outcome

    def _progress(self, outcomes: Sequence[Outcome], count: int) -> dict[str, Any]:
        left, total = count - len(outcomes), self.settings.iterations
        return {
            "iteration": len(outcomes) * total // count,
            "iterations": total,
            "steps": sum(outcome.steps for outcome in outcomes),
            "best": [math.nan if one.diverged else one.fitness for one in outcomes] + [math.nan] * left,
            "training": [False] * len(outcomes) + [True] * left,
        }


class _Done:
    """Outcomes so far and the state of the current training, kept in a checkpoint file if there is one."""

    def __init__(self, about: dict[str, Any], file: Path | None) -> None:
        self.about, self.file = about, file
        self.outcomes: list[Outcome] = []
        self.outcome: Outcome | None = None
        self.training: dict[str, Any] | None = None
        if content := read_evaluation(file, about):
            with damaged(file, AGAIN):
                self.outcomes = list(map(outcome_of, content["outcomes"]))
                if content["training"] is not None:
                    self.outcome, self.training = outcome_of(content["outcome"]), content["training"]

    def add(self, outcome: Outcome) -> None:
        self.outcomes.append(outcome)
        self.outcome = self.training = None
        self.save(None, None)

    def save(self, outcome: Outcome | None, training: dict[str, Any] | None) -> None:
        """Write the checkpoint: outcomes, the current training (:meth:`Runner.state`) and its outcome so far."""
        if self.file is not None:
            outcomes, current = list(map(asdict, self.outcomes)), outcome and asdict(outcome)
            content = {"about": self.about, "outcomes": outcomes, "outcome": current, "training": training}
            save_evaluation(self.file, content)
