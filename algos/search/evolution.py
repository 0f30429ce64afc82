"""Evolution of bodies together with how they move: the best of each island have children, and most bodies come back."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from warpvox.algos.candidate import GAIT, Candidate
from warpvox.algos.search.base import MAX_MUTANT_VOXELS, MUTANTS_PER_DRAW, BaseSearch, Proposal
from warpvox.algos.search.bodies import body_key, first_valid, mutate
from warpvox.algos.search.settings import EvolutionSettings

__all__ = ["EvolutionSearch"]

RATES = (0.4, 1.0, 2.0)
"""A mutation changes a voxel with the probability ``mutation_rate`` times one of these: small and large steps."""


class EvolutionSearch(BaseSearch):
    """The (mu + lambda) scheme: parents and children compete, and the best of both are the next parents.

    A candidate is a body with one way to move it. A child has the body of its parent and moves otherwise (its origin is
    ``gait``), or a mutant of the body; it needs an evaluation that passes on the motion of a parent
    (``evaluation=gaits``). Few candidates of one body may be parents, lest they be all alike.

    Attributes:
        islands: ids of the parents of each island, best first. Islands evolve side by side; now and then the best of
            each also becomes a parent in the next.
    """

    settings: EvolutionSettings
    repeats = True

    def __init__(self, settings: EvolutionSettings, shape: tuple[int, int] = (5, 5), seed: int = 0) -> None:
        super().__init__(settings, shape, seed)
        self.islands: list[list[int]] = [[] for _ in range(settings.islands)]

    def propose(self, rng: np.random.Generator, count: int) -> list[Proposal]:
        """Random bodies first, then children of each island's parents."""
        return [self._child(rng, self.islands[place * len(self.islands) // count]) for place in range(count)]

    def _child(self, rng: np.random.Generator, parents: Sequence[int]) -> Proposal:
        how = self.settings
        if not parents or rng.random() < how.newcomers:
            return self.random_proposal(rng)
        parent = parents[rng.integers(len(parents), size=2).min()]  # the better of two
        if rng.random() < how.same_body:
            return Proposal(self.bodies[parent].copy(), (parent,), GAIT)
        rate, body = min(how.mutation_rate * rng.choice(RATES), 1.0), self.bodies[parent]
        copies, own = np.repeat(body[None], MUTANTS_PER_DRAW, axis=0), body_key(body)
        # a body that is known may do better with another gait
        mutant = first_valid(lambda: mutate(rng, copies, rate), lambda key: key == own, MAX_MUTANT_VOXELS)
        return Proposal(body.copy(), (parent,), GAIT) if mutant is None else Proposal(mutant, (parent,), "mutation")

    def learn(self, candidates: Sequence[Candidate], fitness: Sequence[float]) -> None:
        """Choose the parents anew."""
        children: list[list[int]] = [[] for _ in self.islands]
        for place, candidate in enumerate(candidates):
            children[place * len(self.islands) // len(candidates)].append(candidate.id)
        self.islands = [self._best(old + new) for old, new in zip(self.islands, children, strict=True)]
        if self.generation % self.settings.migration == self.settings.migration - 1:
            best = [parents[:1] for parents in self.islands]
            self.islands = [self._best(one + other) for one, other in zip(self.islands, best[-1:] + best, strict=False)]

    def _best(self, numbers: Sequence[int]) -> list[int]:
        """The next parents of an island; of equals the older one comes first."""
        bodies: Counter[bytes] = Counter()
        chosen: list[int] = []
        for number in sorted(set(numbers), key=lambda number: (-self.fitness[number], number)):
            key = body_key(self.bodies[number])
            bodies[key] += 1
            if bodies[key] <= self.settings.per_body:
                chosen.append(number)
        return chosen[: self._room]

    @property
    def _room(self) -> int:
        """Parents of an island."""
        return self.settings.population // len(self.islands)

    def wanted(self, candidate: Candidate, fitness: float) -> bool:
        """Whether a candidate of this generation may become a parent."""
        asked = self._asked or [candidate]
        parents = self.islands[(candidate.id - asked[0].id) * len(self.islands) // len(asked)]
        return len(parents) < self._room or fitness > self.fitness[parents[-1]]
