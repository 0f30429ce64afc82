"""Evolution of bodies together with how they move: age-fitness Pareto optimisation (Schmidt and Lipson 2011)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from warpvox.algos.candidate import GAIT, Candidate
from warpvox.algos.search.base import MAX_MUTANT_VOXELS, BaseSearch, Proposal
from warpvox.algos.search.bodies import body_key, first_valid
from warpvox.algos.search.settings import EvolutionSettings

__all__ = ["EvolutionSearch"]

RATES = (0.4, 1.0, 2.0)
"""A mutation changes a voxel with the probability ``mutation_rate`` times one of these: small and large steps."""


class EvolutionSearch(BaseSearch):
    """Parents and children compete, and candidates stay that no younger one beats.

    A candidate is a body with one way to move it. A child has the body of its parent and moves otherwise (its origin is
    ``gait``), or a mutant of the body; it needs an evaluation that passes on the motion of a parent
    (``evaluation=gaits``). A candidate is as old as the random body that it descends from. Young lineages are thus not
    driven out by old ones, which have had more time to improve: without that, all parents soon descend from one body.

    Attributes:
        parents: ids, best first.
    """

    settings: EvolutionSettings
    repeats = True

    def __init__(self, settings: EvolutionSettings, shape: tuple[int, int] = (5, 5), seed: int = 0) -> None:
        super().__init__(settings, shape, seed)
        self.parents: list[int] = []
        self._began: list[int] = []  # of each candidate: the generation of the random body that it descends from

    def propose(self, rng: np.random.Generator, count: int) -> list[Proposal]:
        """Random bodies first, then children of the parents, and a few random bodies."""
        return [self._child(rng) for _ in range(count)]

    def _child(self, rng: np.random.Generator) -> Proposal:
        how, parents = self.settings, self.parents
        if not parents or rng.random() < how.newcomers:
            return self.random_proposal(rng)
        parent = parents[rng.integers(len(parents), size=2).min()]  # the better of two
        body, mutant = self.bodies[parent], None
        if rng.random() >= how.same_body:
            draw = self.mutants(rng, parent, min(how.mutation_rate * rng.choice(RATES), 1.0))
            # a body that is known may do better with another gait
            mutant = first_valid(draw, body_key(body).__eq__, MAX_MUTANT_VOXELS)
        return Proposal(body.copy(), (parent,), GAIT) if mutant is None else Proposal(mutant, (parent,), "mutation")

    def learn(self, candidates: Sequence[Candidate], fitness: Sequence[float]) -> None:
        """Choose the next parents."""
        self._began += [self._beginning(candidate) for candidate in candidates]
        self.parents = self._survivors(zip(candidates, fitness, strict=True))

    def wanted(self, candidate: Candidate, fitness: float) -> bool:
        """Whether a candidate of this generation may become a parent: its siblings can only take its place."""
        return candidate.id in self._survivors([(candidate, fitness)])

    def _survivors(self, children: Iterable[tuple[Candidate, float]]) -> list[int]:
        """The parents that there would be with these children and their fitness."""
        known = [(self.fitness[number], self._began[number], number) for number in self.parents]
        new = [(value, self._beginning(child), child.id) for child, value in children]
        return _best(known + new, self.settings.population)

    def _beginning(self, candidate: Candidate) -> int:
        return self._began[candidate.parents[0]] if candidate.parents else candidate.generation


def _best(entries: Sequence[tuple[float, int, int]], count: int) -> list[int]:
    """The ids of ``count`` of the entries (fitness, generation of the beginning, id), the fittest first.

    First those that no entry beats in fitness without being older, then those that only the first ones beat, and so on.
    """
    left = sorted(entries, key=lambda entry: (-entry[0], -entry[1], entry[2]))
    chosen: list[tuple[float, int, int]] = []
    while left and len(chosen) < count:
        front, beaten, youngest = [], [], -1
        for entry in left:
            younger = entry[1] > youngest
            (front if younger else beaten).append(entry)
            youngest = max(youngest, entry[1])
        chosen, left = chosen + front, beaten
    return [number for _, _, number in sorted(chosen[:count], key=lambda entry: (-entry[0], entry[2]))]
