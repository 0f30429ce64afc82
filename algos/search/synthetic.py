"""A made-up fitness with a known optimum: what searches are compared on without training a single controller.

The optimum is a walking shape: a torso of one material on legs of others, drawn from a seed. A body earns for each
voxel that it shares with the optimum, a part for one of the same kind (passive or actuator), and as much again for
every pair of neighbouring voxels that are both right. So good parts help each other, there are plateaus and local
optima, and structure is worth something, as with real bodies; only the optimum earns 1.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from warpvox.algos.candidate import Search
from warpvox.types import Cell

__all__ = ["SyntheticFitness", "best_of"]

PASSIVE, ACTUATORS = (Cell.RIGID, Cell.SOFT), (Cell.H_ACT, Cell.V_ACT)
SAME_KIND = 0.4
"""What a voxel of the right kind but the wrong material earns, next to 1 for the right one."""


class SyntheticFitness:
    """Fitness of bodies, between 0 and 1.

    Args:
        seed: draws the optimum.
        shape: ``(rows, columns)``, at least 3 by 3.

    Attributes:
        optimum: int8 ``[rows, columns]``, the only body of fitness 1.
    """

    def __init__(self, seed: int, shape: tuple[int, int] = (5, 5)) -> None:
        self.optimum = _walker(np.random.default_rng(seed), shape)

    def __call__(self, body: np.ndarray) -> float:
        """Fitness of a body int8 ``[rows, columns]``."""
        right = body == self.optimum
        kind = _kinds(body) == _kinds(self.optimum)
        voxels = np.where(right, 1.0, SAME_KIND * kind).mean()
        pairs = np.concatenate([(right[1:] & right[:-1]).ravel(), (right[:, 1:] & right[:, :-1]).ravel()]).mean()
        return float((voxels + pairs) / 2)


def best_of(search: Search, fitness: Callable[[np.ndarray], float]) -> list[float]:
    """Run a search to its end; returns the best fitness after each evaluation."""
    best: list[float] = []
    while asked := search.ask():
        told = [fitness(candidate.body) for candidate in asked]
        search.tell(told)
        for value in told:
            best.append(max(value, best[-1]) if best else value)
    return best


def _kinds(body: np.ndarray) -> np.ndarray:
    """0 for empty, 1 for passive, 2 for actuators."""
    return np.isin(body, PASSIVE) + 2 * np.isin(body, ACTUATORS)


def _walker(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    rows, columns = shape
    body = np.zeros(shape, np.int8)
    torso = int(rng.integers(1, rows - 1))
    left = int(rng.integers(1, (columns - 1) // 2 + 1))
    right = int(rng.integers(1, (columns - 1) // 2 + 1))
    body[:torso] = rng.choice(PASSIVE)
    body[torso - 1, left : columns - right] = rng.choice(PASSIVE + ACTUATORS)
    body[torso:, :left] = rng.choice(ACTUATORS)
    body[torso:, columns - right :] = rng.choice(ACTUATORS)
    body[-1, :left] = rng.choice(PASSIVE + ACTUATORS)
    return body
