"""Evaluation of a generation of designs in one batch."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

from warpvox.algos.candidate import Candidate, Outcome, Parent, Parents, Report, candidate_seed
from warpvox.algos.checkpoints.files import damaged, read_tensors, save_checkpoint
from warpvox.algos.codesign.inheritance import BodyLayout, copy_weights
from warpvox.algos.env_factory import EnvFactory
from warpvox.algos.interrupt import deferred_interrupts
from warpvox.algos.population.training import Networks, PopulationTraining
from warpvox.algos.settings import DesignTraining
from warpvox.devices.out_of_memory import enough_memory
from warpvox.envs.registry import get_task
from warpvox.envs.vec_env import VoxelVecEnv
from warpvox.errors import RunError
from warpvox.io.writing import writing

AGAIN = " Remove it: these designs are then evaluated again, to the same end."
"""Advice for a checkpoint that cannot be used."""
VERSION = 3
"""Of the checkpoints of trainings under way; others are refused."""


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

    def evaluate(
        self, candidates: Sequence[Candidate], parents: Parents, report: Report = None, checkpoint: Path | None = None
    ) -> list[Outcome]:
        with enough_memory(memory_hint(self.settings, len(candidates))):
            generation = _Generation(self, candidates, parents)
            generation.restore(checkpoint)
            with deferred_interrupts() as interrupted:
                while generation.going:
                    generation.advance()
                    if report is not None:
                        report(generation.progress())
                    due = generation.training.iteration % self.settings.save_interval == 0 and generation.going
                    stop = bool(interrupted)  # an interrupt from here on waits for the next iteration
                    if due or stop:
                        generation.save(checkpoint)
                    if stop:
                        interrupted.stop()
        return generation.outcomes


class _Generation:
    """The state of an evaluation."""

    def __init__(self, evaluator: PopulationEvaluator, candidates: Sequence[Candidate], parents: Parents) -> None:
        self.factory, self.settings, self.seed = evaluator.factory, evaluator.settings, evaluator.seed
        self.candidates, self.parents = list(candidates), parents
        self.seeds = [candidate_seed(evaluator.seed, candidate.id) for candidate in candidates]
        self.about = describe(evaluator.factory, evaluator.settings, evaluator.seed, candidates)
        self.outcomes = [Outcome(-math.inf) for _ in candidates]
        self.halvings = self.settings.halvings()
        self.active = list(range(len(candidates)))
        self.training = self._start()

    def _start(self) -> PopulationTraining:
        inherit = self._inherit if self.settings.inherit else None
        bodies, seeds = zip(*((self.candidates[k].body, self.seeds[k]) for k in self.active), strict=True)
        return PopulationTraining(self.factory, bodies, seeds, self.settings, inherit, self.seed)

    def _inherit(self, design: int, env: VoxelVecEnv, networks: Networks) -> None:
        parent = best_parent(self.candidates[self.active[design]], self.parents)
        if parent is not None:
            inherit_policy(self.factory, parent, env, design, networks)

    @property
    def going(self) -> bool:
        return bool(self.active) and self.training.iteration < self.settings.iterations

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
        return {
            "iteration": self.training.iteration,
            "iterations": self.settings.iterations,
            "steps": sum(outcome.steps for outcome in self.outcomes),
            "best": [outcome.fitness if outcome.curve else math.nan for outcome in self.outcomes],
            "training": [k in self.active and self.going for k in range(len(self.candidates))],
        }

    def save(self, path: Path | None) -> None:
        if path is not None:
            content = {"about": self.about, "active": self.active, "outcomes": list(map(asdict, self.outcomes))}
            save_evaluation(path, content | {"training": self.training.state()})

    def restore(self, path: Path | None) -> None:
        content = read_evaluation(path, self.about)
        if content is None:
            return
        with damaged(path, AGAIN):
            self.outcomes = list(map(outcome_of, content["outcomes"]))
            if content["active"] != self.active:
                self.active = content["active"]
                if not self.active:  # all have diverged: nothing is left to train
                    return
                self.training = self._start()
            self.training.set_state(content["training"])


def describe(factory: EnvFactory, settings: Any, seed: int, candidates: Sequence[Candidate]) -> dict[str, Any]:
    """All that determines the outcomes, as plain values, to recognise a checkpoint; ``settings``: a dataclass."""
    irrelevant, sim = {"save_interval", "method"}, factory.sim
    return {
        "version": VERSION,
        "task": get_task(factory.task).id,
        "simulation": repr((factory.rules, sim.physics, sim.dtype, sim.arithmetic, factory.fitness)),
        "settings": {key: value for key, value in asdict(settings).items() if key not in irrelevant},
        "seed": seed,
        "candidates": [[candidate.id, candidate.body.tolist(), list(candidate.parents)] for candidate in candidates],
    }


def save_evaluation(path: Path, content: dict[str, Any]) -> None:
    """Write the checkpoint of an evaluation.

    StorageError: it cannot be written, or the run's folder no longer exists.
    """
    with writing(path):
        path.parent.mkdir(exist_ok=True)
    save_checkpoint(path, content)


def read_evaluation(path: Path | None, about: dict[str, Any]) -> dict[str, Any] | None:
    """Read the checkpoint of an evaluation; None: there is none.

    RunError: it is damaged, or ``about`` (:func:`describe`) differs.
    """
    if path is None or not path.exists():
        return None
    try:
        content = read_tensors(path)
    except RunError as error:
        raise RunError(f"{str(error).rstrip('.')}.{AGAIN}") from None
    if content.get("about") != about:
        raise RunError(
            f"{path} is the checkpoint of other candidates or settings, or of another version of warpvox; remove it to"
            " begin again."
        )
    return content


def outcome_of(values: dict[str, Any]) -> Outcome:
    """An outcome of the values that a checkpoint has of it."""
    return Outcome(**cast(Any, values | {"curve": [tuple(point) for point in values["curve"]]}))


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
