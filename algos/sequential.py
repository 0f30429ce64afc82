"""Evaluation of designs one after another: a stock rsl-rl training for each, the oracle of the batched one."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from warpvox.algos.arena import Arena
from warpvox.algos.candidate import Candidate, Outcome, Parent, candidate_seed
from warpvox.algos.checkpoint import Controller, read_tensors, save_checkpoint
from warpvox.algos.evaluate import Evaluation, evaluator
from warpvox.algos.population import bequeath, best_parent, describe
from warpvox.algos.population_training import Networks
from warpvox.algos.runner import Runner, Schedule, adapt
from warpvox.configs.schema import TrainingConfig
from warpvox.errors import ConfigError, RunError

__all__ = ["SequentialEvaluator"]


@dataclass(frozen=True)
class SequentialEvaluator:
    """Trains candidate after candidate with :class:`warpvox.algos.runner.Runner`; attributes as for the batched one.

    Raises:
        ConfigError: ``settings.rungs``: without the others there is no race to drop out of.
    """

    arena: Arena
    settings: TrainingConfig
    seed: int = 0

    def __post_init__(self) -> None:
        if self.settings.rungs:
            raise ConfigError("training.rungs needs training.method=population: designs must be trained side by side.")

    def evaluate(
        self,
        candidates: Sequence[Candidate],
        parents: Mapping[int, Parent],
        report: Callable[[dict[str, Any]], None] | None = None,
        checkpoint: Path | None = None,
    ) -> list[Outcome]:
        """See :class:`warpvox.algos.candidate.DesignEvaluator`; the checkpoint holds the outcomes so far.

        Raises:
            RunError: the checkpoint is another's, or learning has diverged.
        """
        about = describe(self.arena, self.settings, self.seed, candidates)
        outcomes = self._restore(checkpoint, about)
        for candidate in candidates[len(outcomes) :]:
            outcomes.append(self._train(candidate, best_parent(candidate, parents)))
            if checkpoint is not None:
                content = {"about": about, "outcomes": [dataclasses.asdict(outcome) for outcome in outcomes]}
                save_checkpoint(checkpoint, content)
            if report is not None:
                report(self._progress(outcomes, len(candidates)))
        return outcomes

    def _restore(self, checkpoint: Path | None, about: dict[str, Any]) -> list[Outcome]:
        if checkpoint is None or not checkpoint.exists():
            return []
        content = read_tensors(checkpoint)
        if content.get("about") != about:
            raise RunError(f"{checkpoint} is the checkpoint of other candidates or settings; remove it to begin anew.")
        return [Outcome(**one | {"curve": [tuple(point) for point in one["curve"]]}) for one in content["outcomes"]]

    def _train(self, candidate: Candidate, parent: Parent | None) -> Outcome:
        settings, seed = self.settings, candidate_seed(self.seed, candidate.id)
        outcome = Outcome(-math.inf)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            env = adapt(self.arena.make([candidate.body], settings.envs, [seed], auto_reset=True), settings.ppo)
            judge = evaluator(self.arena.make([candidate.body], settings.eval_envs, [seed], auto_reset=False), [seed])

            def evaluate(policy: Controller) -> Evaluation:
                result = judge(policy)
                value = float(result.fitness[0])
                done = (runner.current_learning_iteration) * settings.ppo.steps * settings.envs
                outcome.curve.append((done, value))
                if value > outcome.fitness:
                    state = policy.actor.state_dict()
                    outcome.fitness = value
                    outcome.policy = {name: tensor.detach().cpu().clone() for name, tensor in state.items()}
                return result

            schedule = Schedule(settings.iterations, settings.iterations, settings.eval_interval)
            runner = Runner(env, settings.ppo, schedule, evaluator=evaluate)
            if settings.inherit and parent is not None:
                networks = Networks(runner.alg.actor, runner.alg.critic, torch.empty(0))
                bequeath(self.arena, parent, env.env, 0, networks)
            runner.run()
        outcome.steps = runner.steps
        return outcome

    def _progress(self, outcomes: Sequence[Outcome], count: int) -> dict[str, Any]:
        left = count - len(outcomes)
        return {
            "iteration": len(outcomes) * self.settings.iterations // count,
            "iterations": self.settings.iterations,
            "steps": sum(outcome.steps for outcome in outcomes),
            "best": [outcome.fitness for outcome in outcomes] + [math.nan] * left,
            "training": [False] * len(outcomes) + [True] * left,
        }
