"""Data types and protocols shared by searches, evaluators and the archive."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from warpvox.design import Design
from warpvox.errors import RunError

FINALIST = "finalist"
"""Origin of a candidate that evaluates one of the best bodies once more at the end of a search."""
START = "start"
"""Origin of a candidate whose body the user gave to start the search with."""
Report = Callable[[dict[str, Any]], None] | None
"""Callback for progress: ``iteration`` of ``iterations`` of training, control ``steps`` so far over all candidates, and
lists by candidate: ``best`` deterministic return so far (NaN: none yet), whether it is still in ``training``."""


def best_so_far(curve: Sequence[tuple[int, float]]) -> list[tuple[int, float]]:
    """Convert a learning curve (control steps, return) to its running maximum."""
    best = -math.inf
    points = []
    for steps, value in curve:
        best = max(best, value)
        points.append((steps, best))
    return points


def candidate_seed(seed: int, number: int) -> int:
    """Return the seed for training candidate ``number`` in a search with ``seed``.

    An integer of 63 bits, which torch, numpy and SQLite can all represent.
    """
    return int(np.random.SeedSequence([seed, number]).generate_state(1, np.uint64)[0] >> np.uint64(1))


@dataclass(frozen=True)
class Candidate:
    """A design to evaluate, with its number, generation, parents and origin.

    ``id`` numbers the candidates of an experiment from 0 in the order of their proposal; ``body`` is int8
    ``[rows, columns]``; ``parents`` are the ids of the candidates that it descends from; ``origin`` says how it was
    made (``random``, ``mutation``, ``crossover``, ``posterior``, ...).
    """

    id: int
    body: Design
    parents: tuple[int, ...] = ()
    origin: str = "random"
    generation: int = 0

    def __post_init__(self) -> None:
        """Convert the ids and the generation to Python ints."""
        # A search may draw ids with NumPy, and SQLite would store NumPy integers as bytes.
        plain = {"id": int(self.id), "parents": tuple(map(int, self.parents)), "generation": int(self.generation)}
        for name, value in plain.items():
            object.__setattr__(self, name, value)


@dataclass
class Outcome:
    """Result of a candidate's evaluation: fitness, learning curve, policy.

    ``fitness`` is the best deterministic return (paper section C.1), -inf if learning diverged before the first
    evaluation; ``curve`` the returns behind it as (control steps, return): of each evaluation of a training; with gaits
    the best so far, also during a training that follows them; ``steps`` the control steps spent;
    ``policy`` the state of a stock rsl-rl actor, on the CPU; ``stopped``: training ended early, by successive halving
    or because learning diverged; ``spec``: what the policy is built by, see
    :func:`warpvox.algos.checkpoints.files.spec_dict`; None: by the settings of the training.
    """

    fitness: float
    curve: list[tuple[int, float]] = field(default_factory=list)
    steps: int = 0
    policy: dict[str, Any] | None = None
    stopped: bool = False
    spec: dict[str, Any] | None = None

    @property
    def diverged(self) -> bool:
        """True if training diverged before the first evaluation; then there is no fitness."""
        return self.fitness == -math.inf


def checked_outcomes(found: Any, count: int) -> list[Outcome]:
    """Validate the outcomes of ``count`` candidates, and convert their numbers to plain Python ones.

    Raises:
        RunError: it is no list of so many outcomes, or one holds what cannot be stored.
    """
    if not isinstance(found, list | tuple) or not all(isinstance(one, Outcome) for one in found):
        raise RunError(f"An evaluator must return a list of outcomes (warpvox.algos.candidate), got {found!r:.80}.")
    if len(found) != count:
        raise RunError(f"The evaluator gave {len(found)} outcomes for {count} candidates.")
    checked = []
    for index, one in enumerate(found):
        where = f"Outcome {index} of the evaluator has"
        fitness = _number(one.fitness)
        if fitness is None or math.isnan(fitness) or fitness == math.inf:
            raise RunError(f"{where} a fitness that is no finite number, nor -inf: {one.fitness!r:.60}.")
        if not isinstance(one.curve, list | tuple):
            raise RunError(f"{where} a curve that is no list: {one.curve!r:.60}.")
        curve = []
        for point in one.curve:
            pair = tuple(point) if isinstance(point, list | tuple) and len(point) == 2 else (None, None)
            steps = _steps(pair[0])
            value = _number(pair[1])
            if steps is None or value is None or not math.isfinite(value):
                raise RunError(f"{where} a point of its curve that is not (steps, return): {point!r:.60}.")
            curve.append((steps, value))
        steps = _steps(one.steps)
        if steps is None:
            raise RunError(f"{where} steps that are no integer from 0: {one.steps!r:.60}.")
        for name in ("policy", "spec"):
            if not isinstance(getattr(one, name), Mapping | None):
                raise RunError(f"{where} a {name} that is no dictionary: {getattr(one, name)!r:.60}.")
        checked.append(replace(one, fitness=fitness, curve=curve, steps=steps, stopped=bool(one.stopped)))
    return checked


def _number(value: Any) -> float | None:
    """Convert a number, such as one of NumPy's, to float; None: not a number."""
    try:
        return float(value) if hasattr(value, "__float__") else None
    except (TypeError, ValueError, OverflowError, RuntimeError):  # of several numbers
        return None


def _steps(value: Any) -> int | None:
    """Convert a count of control steps to an int that SQLite can hold; None: not a valid count."""
    number = _number(value)
    return int(value) if number is not None and 0 <= number < 2**63 and number.is_integer() else None


@dataclass(frozen=True)
class Parent:
    """An evaluated candidate whose policy a child's training can start from."""

    body: Design
    policy: dict[str, Any]
    fitness: float


Parents = Mapping[int, Parent]
"""Evaluated parents by id."""


class Search(Protocol):
    """Protocol of search algorithms: propose designs and learn from their fitness, without simulating."""

    def ask(self) -> list[Candidate]:
        """Return the next generation, empty when the budget is spent; :meth:`tell` must follow."""
        ...

    def tell(self, fitness: Sequence[float]) -> None:
        """Learn from the fitness of the candidates last asked for, in the same order."""

    def replay(self, history: Sequence[tuple[Sequence[Candidate], Sequence[float]]]) -> None:
        """Restore the state after these finished generations, in order.

        The result is that of asking and telling again, but candidates that are costly to propose are taken as given.
        """


class DesignEvaluator(Protocol):
    """Protocol of evaluators: compute the fitness of designs, for instance by training a policy for each."""

    def evaluate(self, candidates: Sequence[Candidate], parents: Parents, report: Report = None) -> list[Outcome]:
        """Evaluate ``candidates`` and return the outcomes in the same order.

        The same candidates with the same seed of the experiment give the same bits on the same machine. Among other
        candidates an outcome is the same up to rounding, unless successive halving makes them compete.

        Args:
            candidates: one or more to evaluate.
            parents: by their ids, for ``training.inherit``: a child starts from the policy of the best of its
                parents that are listed here.
            report: called with progress, see :data:`Report`.

        Raises:
            RunError: a policy does not fit. DeviceError: memory has run out.
            KeyboardInterrupt: ``report`` has raised it, because somebody wants to stop.
        """
        ...
