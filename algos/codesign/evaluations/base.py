"""How the designs of a search are compared: what every evaluation can be asked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpvox.algos.settings import DesignTraining, Ppo
from warpvox.keys import Settings, key
from warpvox.types import Cell

if TYPE_CHECKING:
    from warpvox.algos.candidate import Candidate, DesignEvaluator, Outcome
    from warpvox.algos.codesign.settings import Codesign
    from warpvox.envs.spec import TaskSpec
    from warpvox.robots.entry import Robot


@dataclass(frozen=True)
class Workload:
    """Designs that are simulated together, for estimates of memory.

    ``envs`` environments for each of ``designs``; ``key`` with its ``value`` sets ``envs``; ``ppo``: of a policy that
    learns.
    """

    designs: int
    envs: int
    key: str
    value: int
    ppo: Ppo | None = None


@dataclass
class Evaluation(Settings):
    """The base of all evaluations, and of your own: ``build`` says how designs are evaluated, the rest has defaults.

    Settings are fields made by :func:`warpvox.keys.key`. ``search`` are always the settings of the design search.

    Raises:
        ConfigError: a setting out of range.
    """

    name: str = key("", "how designs are compared")

    prefix = "evaluation."
    finalists = 0
    """Number of best designs that are evaluated once more at the end of a search (origin ``finalist``)."""

    def build(self, search: Codesign, known: Any) -> DesignEvaluator:
        """The evaluator, made in the process that evaluates; ``known`` is what :meth:`begins_with` has returned."""
        raise NotImplementedError

    def check(self, search: Codesign) -> None:
        """Find settings that do not go together.

        Raises:
            ConfigError: which, and what would.
        """

    def resolved(self, search: Codesign, folder: Path | None) -> Evaluation:
        """A copy with what its names stand for; ``folder``: of a search that is resumed.

        Raises:
            WarpvoxError: what is named does not exist, or does not fit the task and the bodies.
        """
        return self

    def begins_with(self, search: Codesign, start: Sequence[Robot], folder: Path | None) -> Any:
        """Knowledge from before the search that the evaluator needs, such as gaits of ``start``; can be pickled."""
        return None

    def inherits(self, search: Codesign) -> bool:
        """Whether candidates are evaluated with the policies of their parents at hand."""
        return False

    def cost(self, search: Codesign, task: TaskSpec) -> tuple[float, float] | None:
        """About how many control steps a design takes, and all finalists; None: not known beforehand."""
        return None

    def workloads(self, search: Codesign) -> list[Workload]:
        """The largest batches that are simulated, for estimates of memory; none: not known."""
        return []

    def run_of(self, search: Codesign, candidate: Candidate, outcome: Outcome) -> dict[str, Any]:
        """Settings of a training run that differ from the search's own for the policy of a design, to play it by."""
        return {}


def steps_of_training(training: DesignTraining, designs: int) -> float:
    """Control steps that a design's training takes, the mean of ``designs`` side by side with successive halving."""
    left, before, iterations = designs, 0, 0
    for end in [*training.halvings(), training.iterations]:
        iterations += left * (end - before)
        left, before = training.kept(left), end
    return iterations * training.envs * training.ppo.steps / designs


def full_body(shape: Sequence[int]) -> np.ndarray:
    """A body of actuators that fills its grid, int8 ``shape``: the largest there is."""
    return np.full(tuple(shape), Cell.H_ACT, np.int8)
