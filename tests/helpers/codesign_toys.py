"""A cheap, exact search, evaluator and store for tests of the loop and the archive."""

import dataclasses
import json
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from warpvox.algos.archive import FILE, Archive
from warpvox.algos.candidate import Candidate, Outcome, Parent, candidate_seed
from warpvox.algos.codesign.loop import LocalExecutor, Loop
from warpvox.algos.search import ALGORITHMS
from warpvox.design import sample_design
from warpvox.errors import RunError
from warpvox.io.writing import write_text

SEED = 5
POPULATION, GENERATIONS = 6, 5
NEEDS = {"map_elites": pytest.mark.skipif(find_spec("ribs") is None, reason="needs the extra 'search'")}
EVERY = pytest.mark.parametrize(
    "algorithm", [pytest.param(name, marks=NEEDS.get(name, ())) for name in ALGORITHMS if name != "custom"]
)
HASTY = {"bo": {"optimizer_restarts": 1, "optimizer_iterations": 5, "candidates": 40}}
"""Settings of Bayesian optimisation with few fitting steps; turns, seeds and records do not depend on the fit."""


class Killed(Exception):
    """Raised to stop a process's work at the point of a simulated kill."""


class ToySearch:
    """Search that proposes random bodies, then mutants of the two best and one repeated body per generation."""

    def __init__(self, seed: int = SEED, population: int = POPULATION, generations: int = GENERATIONS) -> None:
        self.rng = np.random.default_rng(seed)
        self.population, self.generations = population, generations
        self.all: list[tuple[float, Candidate]] = []
        self.asked: list[Candidate] = []
        self.generation = 0

    def ask(self) -> list[Candidate]:
        if self.generation == self.generations:
            return []
        start, ranked = len(self.all), sorted(self.all, key=lambda pair: (-pair[0], pair[1].id))
        self.asked = []
        for number in range(start, start + self.population):
            parent = ranked[int(self.rng.integers(2))][1] if ranked else None
            body, parents, origin = sample_design((3, 3), self.rng), (), "random"
            if parent is not None and number == start + self.population - 1:
                body, parents, origin = parent.body, (parent.id,), "copy"
            elif parent is not None:
                body, parents, origin = self._mutant(parent.body), (parent.id,), "mutation"
            self.asked.append(Candidate(number, body, parents, origin, self.generation))
        return self.asked

    def tell(self, fitness: Sequence[float]) -> None:
        self.all += zip(fitness, self.asked, strict=True)
        self.generation += 1

    def replay(self, history: Sequence[tuple[Sequence[Candidate], Sequence[float]]]) -> None:
        for candidates, fitness in history:
            asked = self.ask()
            if [item.body.tolist() for item in candidates] != [item.body.tolist() for item in asked]:
                raise RunError("The history is not of this search.")
            self.tell(fitness)

    def _mutant(self, body: np.ndarray) -> np.ndarray:
        changed = body.copy()
        free = np.argwhere(changed == 0)
        place = tuple(free[self.rng.integers(len(free))]) if len(free) else (0, 0)
        changed[place] = 3
        return changed if np.count_nonzero(changed) == 9 else sample_design((3, 3), self.rng)


class ToyEvaluator:
    """Evaluator whose fitness depends on the body, the candidate's seed and its parents' policies."""

    def __init__(self, seconds: float = 0.0, seed: int = SEED) -> None:
        self.seconds, self.seed = seconds, seed
        self.trained: list[int] = []

    def evaluate(
        self,
        candidates: Sequence[Candidate],
        parents: Mapping[int, Parent],
        report: Callable[[dict[str, Any]], None] | None = None,
    ) -> list[Outcome]:
        outcomes = []
        for candidate in candidates:
            time.sleep(self.seconds)
            rng = np.random.default_rng(candidate_seed(self.seed, candidate.id))
            inherited = sum(parents[parent].policy["gain"] for parent in candidate.parents if parent in parents)
            curve = [(100 * k, float(v)) for k, v in enumerate(np.sort(rng.random(3)) + int(candidate.body.sum()), 1)]
            policy = {"gain": float(rng.random()) + 0.5 * inherited}
            self.trained.append(candidate.id)
            outcomes.append(Outcome(curve[-1][1] + policy["gain"], curve, 300, policy, bool(rng.random() < 0.2)))
            if report is not None:
                report({"id": candidate.id})
        return outcomes


class Judge(ToyEvaluator):
    def evaluate(self, *given: Any) -> list[Outcome]:
        return [dataclasses.replace(outcome, policy=None) for outcome in super().evaluate(*given)]


class ToyStore:
    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def save(self, candidate: Candidate, outcome: Outcome) -> tuple[str, str]:
        path = f"policies/{candidate.id}.json"
        write_text(self.folder / path, json.dumps(outcome.policy))
        return path, f"{outcome.policy['gain']!r}"

    def load(self, path: str) -> dict[str, Any]:
        return json.loads((self.folder / path).read_text())


History = list[tuple[list[Candidate], list[float]]]


def run(search: Any, fitness: Callable[[np.ndarray], float], generations: int = 10**6) -> History:
    """Run all generations of a search, or the first ``generations``, with a fitness computed from the bodies."""
    history: History = []
    while len(history) < generations and (asked := search.ask()):
        values = [fitness(candidate.body) for candidate in asked]
        search.tell(values)
        history.append((asked, values))
    return history


def make_loop(folder: Path, **changes: Any) -> Loop:
    """Create a loop with toy search and evaluator, and an archive in ``folder``, new or resumed."""
    folder.mkdir(exist_ok=True)
    path = folder / FILE
    archive = Archive.open(path) if path.exists() else Archive.create(path, {"seed": SEED})
    options = dict(seed=SEED, policies=ToyStore(folder), batch=1, inherit=True) | changes
    search = options.pop("search", None) or ToySearch()
    executor = options.pop("executor", None) or LocalExecutor(ToyEvaluator())
    return Loop(search, executor, archive, **options)
