"""Searches compared on a synthetic fitness with a known optimum, without training a controller.

The optimum is a walking shape: a torso of one material on legs of others, drawn from a seed. A body scores for each
voxel that it shares with the optimum, less for one of the same kind (passive or actuator), and as much again for every
pair of neighbouring voxels that are both right: parts depend on each other, and there are plateaus and local optima.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from warpvox.algos.candidate import Search
from warpvox.algos.search import make_search, settings_from
from warpvox.cli.config import load
from warpvox.types import Cell

SURE = 0.01
FLIPS = 200_000
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


def chance(differences: np.ndarray) -> float:
    """One-sided p value of paired differences: how often random signs add up to as much as they do."""
    signs = np.random.default_rng(0).choice((-1.0, 1.0), (FLIPS, len(differences)))
    reached = signs @ differences >= differences.sum() - 1e-12  # equal but for rounding
    return float((1 + np.count_nonzero(reached)) / (1 + FLIPS))


@cache
def final(algorithm: str, seeds: int, evaluations: int) -> np.ndarray:
    settings = settings_from(load("codesign", [f"search={algorithm}", f"search.max_evaluations={evaluations}"]).search)
    return np.array([best_of(make_search(settings, seed=seed), SyntheticFitness(seed))[-1] for seed in range(seeds)])


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["ga", "cppn_neat", "map_elites", "bo"])
def test_every_search_beats_random_search_in_20_seeds(algorithm: str) -> None:
    if algorithm == "map_elites":
        pytest.importorskip("ribs", reason="MAP-Elites needs the extra 'search'")
    assert chance(final(algorithm, 20, 250) - final("random", 20, 250)) < SURE


@pytest.mark.slow
def test_bayesian_optimisation_beats_the_genetic_algorithm_in_20_seeds() -> None:
    assert chance(final("bo", 20, 250) - final("ga", 20, 250)) < SURE
