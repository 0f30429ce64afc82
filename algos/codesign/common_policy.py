"""Evaluation of a generation of designs by one policy that controls them all, instead of a training for each."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from warpvox.algos.candidate import Candidate, Outcome, Parents, Report, candidate_seed
from warpvox.algos.checkpoints.files import damaged, read_tensors, save_checkpoint, spec_dict
from warpvox.algos.codesign.population_evaluator import AGAIN, describe, read_evaluation, save_evaluation
from warpvox.algos.codesign.stored_policies import policy_sha256
from warpvox.algos.env_factory import EnvFactory
from warpvox.algos.evaluate import evaluator
from warpvox.algos.generators import Generators
from warpvox.algos.policies.registry import voxels_of
from warpvox.algos.settings import Ppo
from warpvox.algos.training.runner import Runner, Schedule, adapt
from warpvox.devices.out_of_memory import enough_memory
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.errors import ActionError, DivergenceError
from warpvox.io.writing import writing

if TYPE_CHECKING:
    from warpvox.algos.codesign.evaluations.common import CommonPolicy


@dataclass
class SharedEvaluator:
    """One policy goes on learning from generation to generation, over all designs of each in one batch.

    It learns by PPO. The fitness of a design is its deterministic return after the iterations of its generation, if
    there are any. What the policy has learned is kept beside the checkpoints (``shared/<generation>.pt``), for an
    experiment that is resumed.

    Attributes:
        factory: makes environments with ``obs="voxel"`` and a grid that has room for all designs.
        settings: how the policy is trained; ``settings.ppo`` has all values of :class:`Ppo`.
        pretrained: checkpoint of a training with such a policy (:func:`load_checkpoint`), from whose weights every
            generation begins; None: from those of the generation before.
    """

    factory: EnvFactory
    settings: CommonPolicy
    seed: int = 0
    pretrained: Mapping[str, Any] | None = None
    _learned: dict[str, Any] | None = field(default=None, init=False, repr=False)

    def evaluate(
        self, candidates: Sequence[Candidate], parents: Parents, report: Report = None, checkpoint: Path | None = None
    ) -> list[Outcome]:
        """The candidates are those of one generation, in turn; DivergenceError: the policy has diverged."""
        if self.pretrained is not None:
            return _Course(self, candidates, self.pretrained).run(report, checkpoint)
        before: list[Path] = []  # what the policy had learned after earlier generations, in their order
        if checkpoint is not None:
            file = checkpoint.parent / "shared" / f"{candidates[0].generation:06}.pt"
            before = sorted(other for other in file.parent.glob("[0-9]*.pt") if other.name < file.name)
        if self._learned is None and before:
            self._learned = read_tensors(before[-1])
        with damaged(before[-1] if before else None):
            course = _Course(self, candidates, self._learned)
        outcomes = course.run(report, checkpoint)
        self._learned = course.runner.alg.save()
        if checkpoint is not None:
            with writing(file):
                file.parent.mkdir(parents=True, exist_ok=True)
            save_checkpoint(file, self._learned)
            for other in before[:-1]:  # the last is what this generation began with, should it have to begin again
                other.unlink()
        return outcomes


class _Course:
    """A generation of the policy: it learns on all designs, then each of them is evaluated.

    Args:
        learned: networks and optimiser to begin with; None: new ones.
    """

    def __init__(
        self, how: SharedEvaluator, candidates: Sequence[Candidate], learned: Mapping[str, Any] | None
    ) -> None:
        self.factory, self.settings, self.seed, self.candidates = how.factory, how.settings, how.seed, list(candidates)
        self.ppo, self.seeds = Ppo(**how.settings.ppo), [candidate_seed(how.seed, one.id) for one in candidates]
        self.learned, self.fresh = learned, how.pretrained is not None  # then schedules begin again
        start = None if learned is None else policy_sha256(learned["actor_state_dict"])
        self.about = describe(how.factory, how.settings, how.seed, candidates) | {"start": start}
        self.hint = (
            f"Take less at once: evaluation.envs is {how.settings.envs} for each of {len(candidates)} designs, the"
            f" steps of evaluation.ppo are {self.ppo.steps}."
        )

    def run(self, report: Report, checkpoint: Path | None) -> list[Outcome]:
        with enough_memory(self.hint):
            try:
                self.runner = self._runner(report, checkpoint)
                self.runner.run()
                return self._judge()
            except (DivergenceError, ActionError) as error:
                raise DivergenceError(
                    f"The policy of all designs has diverged in generation {self.candidates[0].generation}: begin a"
                    " new search with a lower learning rate, evaluation.ppo={learning_rate:1e-4}."
                ) from error

    def _runner(self, report: Report, checkpoint: Path | None) -> Runner:
        settings, ppo = self.settings, self.ppo
        env = adapt(self._make(settings.envs, auto_reset=True), ppo)
        voxels = voxels_of(settings.policy, env.env, settings.network)

        def save() -> None:
            if checkpoint is not None and runner.current_learning_iteration > 0:
                save_evaluation(checkpoint, {"about": self.about, "training": runner.state()})

        def tell(row: Mapping[str, float]) -> None:
            count = len(self.candidates)  # none of which is evaluated yet
            done = {"iteration": int(row["iteration"]), "iterations": settings.iterations, "steps": int(row["steps"])}
            if report is not None:
                report(done | {"best": [math.nan] * count, "training": [True] * count})

        schedule = Schedule(settings.iterations, settings.save_interval)
        generators = Generators(self.seeds[0], str(env.device))
        runner = Runner(env, ppo, schedule, voxels=voxels, on_save=save, generators=generators)
        runner.report = tell
        if content := read_evaluation(checkpoint, self.about):
            with damaged(checkpoint, AGAIN):
                runner.set_state(content["training"])
        elif self.fresh and self.learned is not None:
            runner.begin_with(self.learned, optimizer=True)
        elif self.learned is not None:
            with damaged(None if checkpoint is None else checkpoint.parent / "shared"):
                runner.alg.load(dict(self.learned))
        return runner

    def _make(self, envs: int, auto_reset: bool) -> VoxelVecEnv:
        bodies = [candidate.body for candidate in self.candidates]
        return self.factory.make(bodies, envs, self.seeds, auto_reset, shared=True)

    def _judge(self) -> list[Outcome]:
        runner, settings = self.runner, self.settings
        env = self._make(self.factory.episodes(settings.eval_envs), auto_reset=False)
        runner.alg.eval_mode()
        result = evaluator(env, [self.seed] * len(self.candidates), self.factory.fitness)(runner.controller)
        state = runner.alg.get_policy().state_dict()
        policy = {name: tensor.detach().cpu().clone() for name, tensor in state.items()}
        learning = settings.iterations * self.ppo.steps * settings.envs
        spent = torch.bincount(result.design_index, result.lengths.double())  # by the evaluation of each design
        spec = spec_dict(runner.spec)
        return [
            Outcome(value, [(learning, value)], learning + steps, policy, spec=spec)
            for value, steps in zip(result.fitness.tolist(), spent.long().tolist(), strict=True)
        ]
