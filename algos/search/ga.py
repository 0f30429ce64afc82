"""Genetic algorithm (paper section C.1, Algorithm 1, Table 3): elitism and mutation, no crossover."""

import math
from bisect import bisect_left
from collections.abc import Sequence

import numpy as np

from warpvox.algos.candidate import Candidate
from warpvox.algos.search.base import BaseSearch, Proposal
from warpvox.algos.search.settings import GA


def survivors_of(settings: GA, generation: int, last: int) -> int:
    """Return the number of survivors after ``generation`` >= 1, of ``last`` generations (Algorithm 1).

    ``ceil(population * x)`` with a survival rate x that goes linearly from 0.6 at generation 0 to 0 at the last,
    but at least 2; and never all, so that there is something new.
    """
    start = settings.survivor_rate
    end = settings.final_survivor_rate
    share = start + (end - start) * generation / last
    # Round before ceil: 25 * 0.6 * (1 - 1 / 3) must be 10, not 11 through a rounding error.
    count = math.ceil(round(settings.population * share, 9))
    return min(max(settings.min_survivors, count), settings.population - 1)


def last_generation(settings: GA) -> int:
    """Return N_max of Algorithm 1, so that the generations use up ``max_designs``.

    The paper limits evaluations rather than generations (section D.1), and survivors cost none.
    """
    left = settings.max_designs - settings.population

    def evaluations(last: int) -> int:
        return sum(settings.population - survivors_of(settings, n, last) for n in range(1, last + 1))

    # Bisect: evaluations never fall with the number of generations, and each generation needs at least one.
    return 1 + bisect_left(range(1, max(left, 1)), left, key=evaluations)


class GeneticSearch(BaseSearch):
    """Genetic algorithm: the best designs survive without new evaluation, mutants replace the others.

    Attributes:
        last: number of the last generation, N_max of Algorithm 1.
    """

    settings: GA

    def __init__(self, settings: GA, shape: tuple[int, int] = (5, 5), seed: int = 0) -> None:
        super().__init__(settings, shape, seed)
        self.last = last_generation(settings)
        self.population: list[int] = []

    def survivors(self) -> list[int]:
        """Return the ids of the survivors, best first; in ties the older one comes first."""
        ranked = sorted(self.population, key=lambda number: (-self.fitness[number], number))
        return ranked[: survivors_of(self.settings, self.generation, self.last)]

    def propose(self, rng: np.random.Generator, count: int) -> list[Proposal]:
        """Return random bodies in the first generation, later mutants of the survivors."""
        if self.generation == 0:
            return [self.random_proposal(rng) for _ in range(count)]
        survivors = self.survivors()
        count = min(count, self.settings.population - len(survivors))
        return [self.mutant(rng, survivors, self.settings.mutation_rate) for _ in range(count)]

    def learn(self, candidates: Sequence[Candidate], fitness: Sequence[float]) -> None:
        """Set the population to the survivors and the new candidates."""
        kept = self.survivors() if self.generation else []
        self.population = kept + [candidate.id for candidate in candidates]
