"""The genetic algorithm is the paper's: Algorithm 1 and Table 3, computed here a second time."""

from fractions import Fraction
from math import ceil

import numpy as np
import pytest

from warpvox.algos.search.ga import GeneticSearch, last_generation, survivors_of
from warpvox.algos.search.settings import GA

SIGMAS = 5


def paper_survivors(population: int, generation: int, last: int) -> int:
    """Algorithm 1 in exact arithmetic."""
    rate = Fraction(6, 10) * (1 - Fraction(generation, last))
    return max(2, ceil(population * rate))


@pytest.mark.parametrize("last", [1, 3, 13, 27, 40])
@pytest.mark.parametrize("population", [5, 25, 50])
def test_survivors_of_every_generation(population: int, last: int) -> None:
    settings = GA(population=population)
    for generation in range(1, last + 1):
        assert survivors_of(settings, generation, last) == paper_survivors(population, generation, last)


@pytest.mark.parametrize("evaluations", [10, 25, 26, 250, 500, 750, 100_000])
def test_the_last_generation_is_the_first_that_uses_up_the_evaluations(evaluations: int) -> None:
    settings = GA(max_designs=evaluations)
    last = last_generation(settings)

    def total(generations: int) -> int:
        return 25 + sum(25 - paper_survivors(25, n, generations) for n in range(1, generations + 1))

    assert total(last) >= evaluations
    assert last == 1 or total(last - 1) < evaluations


def fitness_of(body: np.ndarray) -> float:
    return float((body == 3).sum())


def test_the_best_survive_unevaluated_and_breed() -> None:
    search = GeneticSearch(GA(), seed=4)
    population: list[int] = []
    fitness: list[float] = []
    for generation in range(14):
        asked = search.ask()
        if generation:
            survivors = sorted(population, key=lambda number: (-fitness[number], number))
            survivors = survivors[: paper_survivors(25, generation, 13)]
            expected = min(25 - len(survivors), 250 - len(fitness))
            assert {parent for candidate in asked for parent in candidate.parents} <= set(survivors)
            assert {candidate.origin for candidate in asked} == {"mutation"}
        else:
            survivors, expected = [], 25
        assert len(asked) == expected
        population = survivors + [candidate.id for candidate in asked]
        told = [fitness_of(candidate.body) for candidate in asked]
        fitness += told
        search.tell(told)
        assert search.population == population
    assert search.ask() == []
    assert len(fitness) == 250


def test_all_survivors_breed_alike() -> None:
    search = GeneticSearch(GA(), seed=0)
    search.tell([fitness_of(candidate.body) for candidate in search.ask()])
    rng = np.random.default_rng(0)
    parents = [search.mutant(rng, [3, 8, 11, 20], 0.1).parents[0] for _ in range(800)]
    shares = [parents.count(parent) / 800 for parent in (3, 8, 11, 20)]
    assert shares == pytest.approx([0.25] * 4, abs=SIGMAS * (0.25 * 0.75 / 800) ** 0.5)


def test_a_child_of_an_exhausted_family_is_random() -> None:
    search = GeneticSearch(GA(population=4, max_designs=8, mutation_rate=1e-9), shape=(5, 5), seed=0)
    search.tell([0.0] * len(search.ask()))
    assert all(candidate.origin == "random" and candidate.parents == () for candidate in search.ask())
