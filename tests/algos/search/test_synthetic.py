"""The made-up fitness has the optimum it says it has, and searches find their way to it."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from warpvox.algos.search import ALGORITHMS, make_search, settings_from
from warpvox.algos.search.bodies import neighbours
from warpvox.algos.search.synthetic import SyntheticFitness, best_of
from warpvox.cli.config import load
from warpvox.design import check_design, sample_design

SURE = 0.01
SHAPES = st.tuples(st.integers(3, 7), st.integers(3, 8))
FLIPS = 200_000


def chance(differences: np.ndarray) -> float:
    """One-sided p value of paired differences: how often random signs add up to as much as they do."""
    signs = np.random.default_rng(0).choice((-1.0, 1.0), (FLIPS, len(differences)))
    reached = signs @ differences >= differences.sum() - 1e-12  # equal but for rounding
    return float((1 + np.count_nonzero(reached)) / (1 + FLIPS))


@given(st.integers(0, 10**6), SHAPES)
def test_the_optimum_is_a_design_of_fitness_1_and_alone_in_that(seed: int, shape: tuple[int, int]) -> None:
    fitness = SyntheticFitness(seed, shape)
    assert np.array_equal(check_design(fitness.optimum), fitness.optimum)
    assert fitness.optimum.shape == shape
    assert fitness(fitness.optimum) == 1.0
    others = [*neighbours(fitness.optimum[None])[0], *(sample_design((3, 3), seed + k) for k in range(3))]
    for body in others:
        if body.shape == shape and not np.array_equal(body, fitness.optimum):
            assert 0 <= fitness(body) < 1


def test_fitness_by_hand() -> None:
    fitness = SyntheticFitness(0, (3, 3))
    fitness.optimum = np.array([[1, 1, 1], [3, 0, 4], [3, 0, 4]], np.int8)
    body = np.array([[1, 2, 1], [3, 0, 3], [0, 0, 4]], np.int8)
    # right: 1, 1 | 3, 0 | 0, 4; of the right kind: 2 for 1, 3 for 4; wrong: 0 for 3
    voxels = (6 + 2 * 0.4) / 9
    # of the twelve pairs: down (0,0)-(1,0) and (1,1)-(2,1); across (1,0)-(1,1) and (2,1)-(2,2)
    assert fitness(body) == pytest.approx((voxels + 4 / 12) / 2)


def test_seeds_differ() -> None:
    assert len({SyntheticFitness(seed).optimum.tobytes() for seed in range(30)}) > 20


def test_best_of_is_the_running_maximum() -> None:
    search = make_search(ALGORITHMS["random"](population=7, max_evaluations=30), seed=2)
    fitness = SyntheticFitness(5)
    best = best_of(search, fitness)
    assert best == np.maximum.accumulate([fitness(body) for body in search.bodies]).tolist()


@cache
def final(algorithm: str, seeds: int, evaluations: int) -> np.ndarray:
    settings = settings_from(load("codesign", [f"search={algorithm}", f"search.max_evaluations={evaluations}"]).search)
    return np.array([best_of(make_search(settings, seed=seed), SyntheticFitness(seed))[-1] for seed in range(seeds)])


def test_evolution_beats_random_search() -> None:
    """A small edition of the study below: eight pairs can be as sure as 1/256."""
    for algorithm in ("ga", "cppn_neat"):
        assert chance(final(algorithm, 8, 250) - final("random", 8, 250)) < SURE


def test_posterior_samples_are_better_than_the_genetic_algorithm_soon() -> None:
    """Likewise: three optima, small bodies, few evaluations."""
    found = [
        best_of(make_search(settings, (4, 4), seed), SyntheticFitness(seed, (4, 4)))[-1]
        for seed in range(3)
        for settings in (
            ALGORITHMS["bo"](
                acquisition="pathwise",
                population=12,
                max_evaluations=72,
                optimizer_restarts=1,
                optimizer_iterations=30,
                candidates=150,
            ),
            ALGORITHMS["ga"](population=12, max_evaluations=72),
        )
    ]
    assert np.mean(found[::2]) > np.mean(found[1::2])


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["ga", "cppn_neat", "map_elites", "bo"])
def test_every_search_beats_random_search_in_20_seeds(algorithm: str) -> None:
    if algorithm == "map_elites":
        pytest.importorskip("ribs", reason="MAP-Elites needs the extra 'search'")
    assert chance(final(algorithm, 20, 250) - final("random", 20, 250)) < SURE


@pytest.mark.slow
def test_bayesian_optimisation_beats_the_genetic_algorithm_in_20_seeds() -> None:
    assert chance(final("bo", 20, 250) - final("ga", 20, 250)) < SURE
