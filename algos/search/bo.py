"""Bayesian optimisation (paper section C.2, Algorithm 2, Table 4) with BoTorch."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from warpvox.algos.candidate import Candidate
from warpvox.algos.search.base import BaseSearch, Proposal
from warpvox.algos.search.bo_acquire import (
    ascend,
    climb_posterior,
    fit_model,
    improve,
    log_improvement,
    seeded_torch,
    thompson_starts,
)
from warpvox.algos.search.bodies import body_key, mutate
from warpvox.algos.search.settings import BO
from warpvox.design import are_valid, draw_bodies


class BayesianSearch(BaseSearch):
    """Bayesian optimisation: fits a Gaussian process to all evaluated designs and proposes promising ones.

    ``acquisition="paper"``: of random designs, batch Thompson sampling picks the starts; from each, L-BFGS climbs
    expected improvement. Nearly all ends, rounded to voxels, are one and the same body or not valid; so a climb goes
    on voxel by voxel, from its end or its start, over valid bodies that have not been proposed yet, and each start
    leads to a body of its own.

    ``acquisition="lbfgs"``: the same with L-BFGS alone; where its end is not valid or not new, the start is taken.

    ``acquisition="pathwise"``: each design is the summit of one function drawn from the posterior, climbed voxel by
    voxel over valid bodies. If that is known already, the best new body beside it or in the pool is taken. Where
    the climb has begun at a mutant of a design, this is the parent.
    """

    settings: BO

    def propose(self, rng: np.random.Generator, count: int) -> list[Proposal]:
        """Return random bodies in the first generation, later maximisers of the acquisition function."""
        if self.generation == 0:
            return [self.random_proposal(rng) for _ in range(count)]
        propose = (
            self._propose_by_posterior if self.settings.acquisition == "pathwise" else self._propose_by_improvement
        )
        # The model takes squares, which overflow for a fitness beyond 1e9.
        scale = max(1.0, *(abs(value) / 1e9 for value in self.fitness))
        with seeded_torch(int(rng.integers(2**63))):
            proposals = propose(rng, count, [value / scale for value in self.fitness])
        # Fill up with random bodies: small shapes may give too few proposals.
        return proposals + [self.random_proposal(rng) for _ in range(count - len(proposals))]

    def recall(self, candidates: Sequence[Candidate]) -> None:
        """Accept ``candidates`` without fitting the process again, which would take minutes."""
        self.adopt(candidates)

    def _propose_by_improvement(self, rng: np.random.Generator, count: int, fitness: list[float]) -> list[Proposal]:
        """Propose bodies of high expected improvement, starting from Thompson samples."""
        pool, _ = self.pool(rng, self.settings.candidates, 0)
        if not len(pool):
            return []
        model = fit_model(np.stack(self.bodies), fitness, self.settings)
        starts = pool[thompson_starts(model, pool, min(count, len(pool)))]
        best = max(fitness)
        ends = improve(model, best, starts, self.settings.optimizer_iterations)
        if self.settings.acquisition == "lbfgs":
            chosen = self._ends_or_starts(starts, ends)
        else:
            chosen = self._climb_ends(log_improvement(model, best), starts, ends)
        return [Proposal(body, (), "improvement" if moved else "thompson") for body, moved in chosen]

    def _ends_or_starts(self, starts: np.ndarray, ends: np.ndarray) -> Iterator[tuple[np.ndarray, bool]]:
        """Yield each climb's end, or its start if the end is invalid or known, and whether it moved."""
        for start, end, good in zip(starts, ends, are_valid(ends), strict=True):
            if good and self.claim(end):
                yield end, not np.array_equal(end, start)
            elif self.claim(start):  # False if an earlier climb ended at this start
                yield start, False

    def _climb_ends(
        self, values: Callable[[np.ndarray], np.ndarray], starts: np.ndarray, ends: np.ndarray
    ) -> Iterator[tuple[np.ndarray, bool]]:
        """Yield the end of each climb, and whether it differs from the start."""

        def free(bodies: np.ndarray) -> np.ndarray:
            return are_valid(bodies) & np.array([not self.is_known(body_key(body)) for body in bodies])

        for start, end in zip(starts, ends, strict=True):
            summit = ascend(values, np.stack([end, start]), free)
            if summit is not None and self.claim(summit):
                yield summit, not np.array_equal(summit, start)

    def _propose_by_posterior(self, rng: np.random.Generator, count: int, fitness: list[float]) -> list[Proposal]:
        """Propose the maximisers of ``count`` functions drawn from the posterior."""
        # A quarter of the pool is random; the rest are mutants of the best.
        random = max(1, round(self.settings.candidates * 0.25))
        pool, parents = self.pool(rng, random, self.settings.candidates - random)
        if not len(pool):
            return []
        model = fit_model(np.stack(self.bodies), fitness, self.settings)
        climb = climb_posterior(model, pool, count)
        proposals: list[Proposal] = []
        for path, start in enumerate(climb.start):
            # Take the summit if it is new, else the best new neighbour of it, else the best new body of the pool.
            near = np.concatenate([climb.summit[path : path + 1], climb.around[path]])
            if (place := self._claim_best(near, np.append(np.inf, climb.at_around[path]))) is not None:
                proposals.append(Proposal(near[place], parents[int(start)], "posterior"))
            elif (place := self._claim_best(pool, climb.at_pool[path])) is not None:
                proposals.append(Proposal(pool[place], parents[place], "posterior"))
        return proposals

    def _claim_best(self, bodies: np.ndarray, values: np.ndarray) -> int | None:
        """Claim the new body with the highest value and return its index, or None."""
        places = (place for place in np.argsort(-values, kind="stable") if values[place] > -np.inf)
        return next((int(place) for place in places if self.claim(bodies[place])), None)

    def pool(self, rng: np.random.Generator, random: int, mutants: int) -> tuple[np.ndarray, list[tuple[int, ...]]]:
        """Draw new bodies to choose from: ``random`` random bodies and ``mutants`` of the best designs.

        Returns:
            New valid bodies int8 ``[m, rows, columns]``, all different, and the parents of each: none, or the one.
        """
        # Mutants in the pool come from the best 25 designs.
        best = np.array(sorted(range(len(self.bodies)), key=lambda number: (-self.fitness[number], number))[:25])
        stack = np.stack(self.bodies)

        drawn = 500  # at a time

        def draw_random() -> tuple[np.ndarray, list[tuple[int, ...]]]:
            return draw_bodies(rng, drawn, self.shape), [()] * drawn

        def draw_mutants() -> tuple[np.ndarray, list[tuple[int, ...]]]:
            parents = rng.choice(best, drawn)
            # With 25 voxels, two thirds of the mutants have about one change, the others two to three.
            rates = rng.choice((0.04, 0.1), drawn, p=(2 / 3, 1 / 3))
            return mutate(rng, stack[parents], rates[:, None, None]), [(parent,) for parent in parents.tolist()]

        found: dict[bytes, tuple[np.ndarray, tuple[int, ...]]] = {}
        for draw, count in (draw_random, random), (draw_mutants, mutants):
            total = len(found) + count
            # Small shapes may have fewer new bodies than are wanted.
            for _ in range(60):
                if len(found) >= total:
                    break
                bodies, parents = draw()
                for place in np.flatnonzero(are_valid(bodies)):
                    key = body_key(bodies[place])
                    if len(found) < total and not self.is_known(key):
                        found.setdefault(key, (bodies[place], parents[place]))
        bodies = [body for body, _ in found.values()]
        parents = [parent for _, parent in found.values()]
        return np.stack(bodies) if bodies else np.zeros((0, *self.shape), np.int8), parents
