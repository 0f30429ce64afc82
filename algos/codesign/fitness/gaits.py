"""Fitness by open-loop gaits that evolve with the designs, without training."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpvox.algos.candidate import FINALIST
from warpvox.algos.codesign.fitness.specialist import Specialist
from warpvox.algos.codesign.settings import Codesign, Workload, register_fitness
from warpvox.algos.protocols import NOMINAL
from warpvox.errors import ConfigError
from warpvox.keys import key

if TYPE_CHECKING:
    from warpvox.algos.candidate import Candidate, DesignEvaluator, Outcome
    from warpvox.algos.robots.entry import Robot
    from warpvox.envs.spec import TaskSpec


@register_fitness
@dataclass
class Gaits(Specialist):
    """Fitness by gaits: the best return of a design's open-loop gaits, which children inherit."""

    name: str = key("gaits", "open-loop gaits evolve with the designs", choices=("gaits",))
    finalists: int = key(4, "number of best designs that get a training of their own at the end", low=1)
    gaits: int = key(8, "open-loop gaits that each design tries in a round", low=1)
    rounds: int = key(2, "number of rounds; from the second on mutants of the best gait so far are tried", low=0)
    stages: int = key(4, "parts of an episode in which a gait has a motion each", low=1, high=100)
    passes: int = key(0, "beam searches before the rounds, in which a gait grows stage by stage", low=0)
    beam: int = key(32, "motions that a design tries in each stage of a beam search", low=1)
    stage_steps: int = key(
        20, "control steps of a stage in the first beam search; others have longer and shorter ones", low=1
    )
    episodes: int | None = key(
        None, "episodes of each gait; null: 1; with protocol=noise and in tasks that draw at random 4", low=1
    )
    final_rounds: int = key(40, "number of rounds for finalists, before their training", low=0)
    final_gaits: int | None = key(None, "gaits that a finalist tries in a round; null: as many as the others", low=1)
    final_passes: int = key(14, "beam searches for finalists, before their rounds", low=0)
    final_beam: int = key(64, "motions that a finalist tries in each stage of a beam search", low=1)

    def check(self, search: Codesign) -> None:
        """Raise an error unless the finalists' training is valid and there is at least one pass or round."""
        super().check(search)
        if search.training.inherit:
            raise ConfigError(
                "training.inherit does not go with fitness=gaits: the trainings of the finalists begin with new"
                " networks."
            )
        for prefix, passes, rounds in ("", self.passes, self.rounds), ("final_", self.final_passes, self.final_rounds):
            if passes + rounds == 0:
                raise ConfigError(
                    f"fitness.{prefix}passes and fitness.{prefix}rounds are both 0: one of them must be 1 or"
                    " more, or no gait is tried."
                )

    def begins_with(self, search: Codesign, start: Sequence[Robot], folder: Path | None) -> Any:
        """Return the gaits of the robots in ``start``, by the bytes of their bodies."""
        from warpvox.algos.codesign.gaits import Gait

        found = {}
        for robot in start:
            if not robot.has_feedback:
                state = robot.own_policy.actor.state_dict()
                arrays = {field.name: state[field.name].numpy() for field in dataclasses.fields(Gait)}
                found[robot.body.tobytes()] = Gait(**arrays)
        return found

    def inherits(self, search: Codesign) -> bool:
        return True

    def cost(self, search: Codesign, task: TaskSpec) -> tuple[float, float]:
        steps = self._episodes(search) * task.max_episode_steps
        first = self.passes * self.beam + self.rounds * self.gaits
        last = self.final_passes * self.final_beam + self.final_rounds * self._final_gaits
        return first * steps, self.finalists * (last * steps + search.training.steps_of_design(self.finalists))

    def workloads(self, search: Codesign) -> list[Workload]:
        """Return the sizes of the largest simulated batches, for memory estimates: trainings and gaits."""
        first = {"fitness.gaits": self.gaits, "fitness.beam": self.beam if self.passes else 1}
        last = {"fitness.final_gaits": self._final_gaits}
        last["fitness.final_beam"] = self.final_beam if self.final_passes else 1
        found = super().workloads(search)
        for designs, keys in ((search.search.population, first), (self.finalists, last)):
            name = max(keys, key=keys.__getitem__)
            together = min(search.batch or designs, designs)
            found.append(Workload(together, keys[name] * self._episodes(search), name, keys[name]))
        return found

    def _episodes(self, search: Codesign) -> int:
        """Return the number of episodes per gait."""
        from warpvox.envs.registry import get_task

        # Four episodes where they differ: in random tasks, and with noise on the actions.
        return self.episodes or (4 if search.protocol != NOMINAL or get_task(search.task).is_random else 1)

    def _final_episodes(self, search: Codesign) -> int:
        """Return the number of evaluation episodes of a finalist's training."""
        return search.training.episodes or self._episodes(search)

    @property
    def _final_gaits(self) -> int:
        """Number of gaits of a finalist in each round."""
        return self.final_gaits or self.gaits

    def build(self, search: Codesign, known: Any) -> DesignEvaluator:
        """Create the evaluator by gaits; finalists get more gaits, and a training each."""
        from warpvox.algos.codesign.finalists import TwoStages
        from warpvox.algos.codesign.gait_evaluator import GaitEvaluator

        factory = search.factory()
        episodes = self._episodes(search)
        more = dataclasses.replace(
            self,
            gaits=self._final_gaits,
            rounds=self.final_rounds,
            passes=self.final_passes,
            beam=self.final_beam,
        )
        training = dataclasses.replace(search.training, episodes=self._final_episodes(search))
        return TwoStages(
            GaitEvaluator(factory, self, search.seed, episodes, known),
            GaitEvaluator(factory, more, search.seed, episodes, known),
            super().build(dataclasses.replace(search, training=training), known),
        )

    def run_of(self, search: Codesign, candidate: Candidate, outcome: Outcome) -> dict[str, Any]:
        """Return the settings to play a design's policy: observations, lanes and episodes of its gait or training."""
        if not (outcome.spec and outcome.spec.get("gait")):
            return {"episodes": self._final_episodes(search)}
        count = self._final_gaits if candidate.origin == FINALIST else self.gaits
        lanes = search.factory().shared_lanes(count * self._episodes(search))
        return {"obs": "timed", "lanes": lanes, "episodes": self._episodes(search)}
