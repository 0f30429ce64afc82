"""Base class of search algorithms: ask and tell, numbering, budget, no body proposed twice."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from warpvox.algos.candidate import START, Candidate
from warpvox.algos.search.bodies import body_key, count_valid, mutate
from warpvox.algos.search.settings import SearchSettings
from warpvox.checks import check_integer, check_shape
from warpvox.design import are_valid, check_design, draw_bodies, repair_design
from warpvox.errors import ConfigError, DesignError, SearchError


@dataclass(frozen=True)
class Proposal:
    """A body int8 ``[rows, columns]`` proposed by a search, before numbering as a :class:`Candidate`."""

    body: np.ndarray
    parents: tuple[int, ...] = ()
    origin: str = "random"


class BaseSearch(ABC):
    """Base class of search algorithms that propose whole generations.

    A subclass says what to propose (:meth:`propose`) and, if it keeps more than the record of all designs, what
    to learn (:meth:`learn`). It draws from the Generator it is given, which follows from the seed and the number
    of the generation: a search is a function of its settings, its seed and the fitness it was given.

    Args:
        settings: of the algorithm.
        shape: ``(rows, columns)`` of the bodies.
        seed: of all random numbers, >= 0.

    Attributes:
        generation: number of the next generation, or of the last one while its fitness is awaited.
        bodies: all bodies with a known fitness, by id, int8 ``[rows, columns]``.
        fitness: of each of them.

    Raises:
        ConfigError: a shape with hardly more valid bodies than ``max_designs``, or a bad shape or seed.
    """

    takes_start: ClassVar[bool] = True
    """True if the first generation may contain given bodies, see :meth:`start_with`."""

    def __init__(self, settings: SearchSettings, shape: tuple[int, int] = (5, 5), seed: int = 0) -> None:
        self.settings = settings
        self.shape = check_shape("shape", shape)
        self.seed = check_integer("seed", seed, 0)
        rows, columns = self.shape
        most = settings.max_designs
        # With too few bodies a search would spend its time on drawing known ones. Up to six voxels they are counted.
        if rows * columns <= 6 and (bodies := count_valid(self.shape)) < 2 * most:
            raise ConfigError(
                f"There are only {bodies} valid bodies of {rows}x{columns}: a search with max_designs={most} needs"
                f" at least twice as many bodies. Use a larger shape or max_designs={bodies // 2} at most."
            )
        self.generation = 0
        self.bodies: list[np.ndarray] = []
        self.fitness: list[float] = []
        self._seen: set[bytes] = set()
        self._asked: list[Candidate] | None = None
        self._start: list[Proposal] = []

    def start_with(self, bodies: Sequence[np.ndarray]) -> None:
        """Set the bodies that begin the first generation, before the first :meth:`ask`.

        Raises:
            ConfigError: bodies of another shape, equal ones or too many, or a search that makes all bodies itself.
            DesignError: a body that is not valid.
        """
        if not self.takes_start:
            raise ConfigError(
                f"search.algorithm={self.settings.algorithm} makes all bodies itself: start goes with the others."
            )
        most = min(self.settings.population, self.settings.max_designs)
        if len(bodies) > most:
            raise ConfigError(f"start has {len(bodies)} robots, the first generation {most} designs.")
        for body in bodies:
            check_design(body)
            if body.shape != self.shape:
                raise ConfigError(f"start has a body of shape {list(body.shape)}: expected {list(self.shape)}.")
        if len({body_key(body) for body in bodies}) < len(bodies):
            raise ConfigError("start has the same body twice: leave one of the robots away.")
        self._start = [Proposal(body.copy(), origin=START) for body in bodies]

    @abstractmethod
    def propose(self, rng: np.random.Generator, count: int) -> list[Proposal]:
        """Return up to ``count`` new bodies, at least one, each accepted by :meth:`claim`."""

    def learn(self, candidates: Sequence[Candidate], fitness: Sequence[float]) -> None:  # noqa: B027  (a choice)
        """Update the model after a generation, which ``bodies`` and ``fitness`` already contain."""

    def claim(self, body: np.ndarray) -> bool:
        """Mark ``body`` as proposed; return False if it was proposed before."""
        key = body_key(body)
        new = key not in self._seen
        self._seen.add(key)
        return new

    def is_known(self, key: bytes) -> bool:
        """Return whether a body was proposed before, given its :func:`body_key`."""
        return key in self._seen

    def new_body(self, draw: Callable[[], np.ndarray], limit: int = 2_000_000) -> np.ndarray | None:
        """Draw bodies ``[n, rows, columns]`` until one is valid and new, and claim it; None after ``limit`` voxels."""
        drawn = 0
        while drawn < limit:
            bodies = draw()
            drawn += bodies.size
            for index in np.flatnonzero(are_valid(bodies)):
                if self.claim(bodies[index]):
                    return bodies[index]
        return None

    def random_proposal(self, rng: np.random.Generator) -> Proposal:
        """Return a new random body by EvoGym's sampling rule (large shapes: :func:`warpvox.sample_design`).

        Raises:
            SearchError: none turns up.
        """
        # About one random body in seven of 5x5 is valid.
        body = self.new_body(lambda: draw_bodies(rng, 32, self.shape))
        if body is None:  # the cells of large shapes hardly ever hang together
            body = self.new_body(lambda: np.stack([*map(repair_design, draw_bodies(rng, 32, self.shape))]), 50_000)
        if body is None:
            fewer = f", or fewer evaluations than max_designs={self.settings.max_designs}" if self._seen else ""
            raise SearchError(
                f"No new {self.shape[0]}x{self.shape[1]} body turns up after {len(self._seen)} have been proposed:"
                f" {'too few are left, or ' if self._seen else ''}random cells of this shape hardly ever hang together."
                f" Try another shape{fewer}."
            )
        return Proposal(body)

    def mutant(self, rng: np.random.Generator, parents: Sequence[int], rate: float) -> Proposal:
        """Return a new mutant of a random parent, or a random body if all mutants are known."""
        for parent in rng.permutation(parents):
            # Draw sixteen mutants at a time and take the first valid new one. After 100,000 voxels try another parent.
            copies = np.repeat(self.bodies[int(parent)][None], 16, axis=0)
            body = self.new_body(partial(mutate, rng, copies, rate), 100_000)
            if body is not None:
                return Proposal(body, (int(parent),), "mutation")
        return self.random_proposal(rng)

    def ask(self) -> list[Candidate]:
        """Return the next generation of new valid bodies; empty when the budget is spent.

        Raises:
            SearchError: the fitness of the last generation is missing, no new body can be found, or a subclass has
                proposed what no candidate may be.
        """
        if self._asked is not None:
            raise SearchError(
                f"ask() was called twice: tell() the fitness of the {len(self._asked)} candidates of generation"
                f" {self.generation} first."
            )
        left = self.settings.max_designs - len(self.bodies)
        if left <= 0:
            return []
        # 0x5EA2C4 keeps the random numbers of a search apart from those of the trainings, which follow from
        # (seed, candidate).
        rng = np.random.default_rng([0x5EA2C4, self.seed, self.generation])
        wanted = min(self.settings.population, left)
        proposals = [] if self.generation else [known for known in self._start if self.claim(known.body)]
        if len(proposals) < wanted:
            proposals += self.propose(rng, wanted - len(proposals))
        self._check(proposals, wanted)
        first = len(self.bodies)
        self._asked = [
            Candidate(first + place, proposal.body, proposal.parents, proposal.origin, self.generation)
            for place, proposal in enumerate(proposals)
        ]
        # Return copies: changes made by the caller must not reach our record.
        return [replace(candidate, body=candidate.body.copy()) for candidate in self._asked]

    def tell(self, fitness: Sequence[float]) -> None:
        """Store the fitness of the candidates last asked for, in their order; larger is better.

        Raises:
            SearchError: nothing was asked for, or not one finite number per candidate.
        """
        if self._asked is None:
            raise SearchError("tell() was called without ask(): there are no candidates that wait for their fitness.")
        asked = self._asked
        try:
            values = [float(value) for value in fitness]
        except (TypeError, ValueError):
            raise SearchError(f"tell() needs a list of {len(asked)} numbers, got {fitness!r:.80}.") from None
        if len(values) != len(asked):
            raise SearchError(f"tell() needs one fitness per candidate: expected {len(asked)}, got {len(values)}.")
        for candidate, value in zip(asked, values, strict=True):
            if not math.isfinite(value):
                raise SearchError(f"The fitness of candidate {candidate.id} must be a finite number, got {value}.")
        self.bodies += [candidate.body for candidate in asked]
        self.fitness += values
        self.learn(asked, values)
        self._asked = None
        self.generation += 1

    def replay(self, history: Sequence[tuple[Sequence[Candidate], Sequence[float]]]) -> None:
        """Restore the state after the generations in ``history``; SearchError: this search proposes others.

        Args:
            history: of each generation from the first: its candidates, as they were proposed, and their fitness.

        Raises:
            SearchError: the search would have proposed something else, or was used before.
        """
        if self._asked is not None or self.bodies:
            raise SearchError("replay() needs a fresh search: this one was asked already.")
        for candidates, fitness in history:
            self.recall(candidates)
            self.tell(fitness)

    def recall(self, candidates: Sequence[Candidate]) -> None:
        """Ask again and verify that the proposals equal ``candidates``; costly searches call :meth:`adopt`."""
        again = self.ask()
        if [(one.id, one.body.tolist()) for one in candidates] != [(one.id, one.body.tolist()) for one in again]:
            raise SearchError(
                f"The history is not of this search: generation {again[0].generation if again else 'the last'} holds"
                " other designs than these settings and this seed propose. It comes from other settings, another seed"
                " or another version, or was changed."
            )

    def adopt(self, candidates: Sequence[Candidate]) -> None:
        """Accept ``candidates`` as the next generation without proposing them again.

        Raises:
            SearchError: they cannot have been the next generation of this search.
        """
        first = len(self.bodies)
        left = self.settings.max_designs - len(self.bodies)
        fits = 0 < len(candidates) <= min(left, self.settings.population)
        for place, candidate in enumerate(candidates):
            in_order = candidate.id == first + place and candidate.generation == self.generation
            fits = fits and in_order and candidate.body.shape == self.shape and self.claim(candidate.body)
        if not fits:
            raise SearchError(
                f"The history is not of this search: what it has for generation {self.generation} differs from the"
                f" search's shape {self.shape}, population, budget or numbering, or repeats a body."
            )
        self._asked = list(candidates)

    def _check(self, proposals: Sequence[Proposal], wanted: int) -> None:
        """Raise SearchError if a subclass proposed invalid, repeated or too many bodies."""
        who = f"{type(self).__name__} proposed"
        if not proposals:
            raise SearchError(f"{who} no body for generation {self.generation}: at least one of {wanted} is needed.")
        if len(proposals) > wanted:
            raise SearchError(f"{who} {len(proposals)} bodies where {wanted} were wanted.")
        keys = {body_key(proposal.body) for proposal in proposals}
        if len(keys) < len(proposals) or not keys.isdisjoint(map(body_key, self.bodies)):
            raise SearchError(f"{who} a body twice: use those for which claim() is true.")
        self._seen |= keys
        for proposal in proposals:
            if proposal.body.shape != self.shape:
                raise SearchError(f"{who} a body of shape {proposal.body.shape}: expected {self.shape}.")
            try:
                check_design(proposal.body)
            except DesignError as error:
                raise SearchError(f"{who} a body that is not valid. {error}") from error
            if not all(0 <= parent < len(self.bodies) for parent in proposal.parents):
                raise SearchError(f"{who} a body with parents {proposal.parents}: expected ids of evaluated bodies.")


class RandomSearch(BaseSearch):
    """Random search without repetition, by EvoGym's sampling rule: the baseline."""

    def propose(self, rng: np.random.Generator, count: int) -> list[Proposal]:
        return [self.random_proposal(rng) for _ in range(count)]
