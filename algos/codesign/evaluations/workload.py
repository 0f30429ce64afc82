"""Memory and control steps that the evaluation of designs takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warpvox.algos.settings import DesignTraining, Ppo
from warpvox.types import Cell


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


def steps_of_training(training: DesignTraining, designs: int) -> float:
    """Control steps that a design's training takes, the mean of ``designs`` side by side with successive halving."""
    left = designs
    before = 0
    iterations = 0
    for end in [*training.halvings(), training.iterations]:
        iterations += left * (end - before)
        left = training.kept(left)
        before = end
    return iterations * training.envs * training.ppo.steps / designs


def full_body(shape: Sequence[int]) -> np.ndarray:
    """A body of actuators that fills its grid, int8 ``shape``: the largest there is."""
    return np.full(tuple(shape), Cell.H_ACT, np.int8)
