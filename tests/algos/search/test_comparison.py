"""Searches compared on a synthetic fitness with a known optimum, without training a controller.

A body scores for each voxel that it shares with the optimum, a walking shape drawn from a seed, less for one of the
same kind (passive or actuator), and as much again for every pair of neighbouring voxels that are both right: parts
depend on each other, and there are plateaus and local optima.
"""

from functools import cache

import numpy as np
import pytest

from warpvox.algos.search import make_search
from warpvox.cli.config import load
from warpvox.types import Cell

pytestmark = pytest.mark.slow
SURE, SEEDS, FLIPS = 0.01, 20, 200_000
PASSIVE, ACTUATORS = (Cell.RIGID, Cell.SOFT), (Cell.H_ACT, Cell.V_ACT)


def walker(rng: np.random.Generator) -> np.ndarray:
    """A torso of one material on legs of others."""
    body, torso = np.zeros((5, 5), np.int8), int(rng.integers(1, 4))
    left, right = rng.integers(1, 3, 2)
    body[:torso] = rng.choice(PASSIVE)
    body[torso - 1, left : 5 - right] = rng.choice(PASSIVE + ACTUATORS)
    body[torso:, :left], body[torso:, 5 - right :] = rng.choice(ACTUATORS), rng.choice(ACTUATORS)
    body[-1, :left] = rng.choice(PASSIVE + ACTUATORS)
    return body


def kinds(body: np.ndarray) -> np.ndarray:
    return np.isin(body, PASSIVE) + 2 * np.isin(body, ACTUATORS)


def fitness(body: np.ndarray, optimum: np.ndarray) -> float:
    right = body == optimum
    voxels = np.where(right, 1.0, 0.4 * (kinds(body) == kinds(optimum))).mean()
    pairs = np.concatenate([(right[1:] & right[:-1]).ravel(), (right[:, 1:] & right[:, :-1]).ravel()]).mean()
    return float((voxels + pairs) / 2)


@cache
def best(algorithm: str) -> np.ndarray:
    """The best fitness after 250 evaluations, seed by seed."""
    settings = load("codesign", [f"search={algorithm}", "search.max_designs=250"]).search
    found = []
    for seed in range(SEEDS):
        search, optimum, values = make_search(settings, seed=seed), walker(np.random.default_rng(seed)), []
        while asked := search.ask():
            search.tell([fitness(candidate.body, optimum) for candidate in asked])
            values += [fitness(candidate.body, optimum) for candidate in asked]
        found.append(max(values))
    return np.array(found)


@pytest.mark.parametrize(
    ("better", "worse"), [*((name, "random") for name in ("ga", "cppn_neat", "map_elites", "bo")), ("bo", "ga")]
)
def test_one_search_is_better_than_another(better: str, worse: str) -> None:
    """By a one-sided test of paired differences: how often random signs add up to as much as they do."""
    if better == "map_elites":
        pytest.importorskip("ribs", reason="MAP-Elites needs the extra 'search'")
    differences = best(better) - best(worse)
    signs = np.random.default_rng(0).choice((-1.0, 1.0), (FLIPS, SEEDS))
    reached = np.count_nonzero(signs @ differences >= differences.sum() - 1e-12)  # equal but for rounding
    assert (1 + reached) / (1 + FLIPS) < SURE
