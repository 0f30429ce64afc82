"""What holds for every search: valid and unique designs, turns, budget, seeds, replay, a true family tree."""

from __future__ import annotations

import random
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec

import numpy as np
import pytest

from warpvox.algos.candidate import Candidate
from warpvox.algos.search import ALGORITHMS, make_search
from warpvox.algos.search.base import BaseSearch
from warpvox.algos.search.bodies import body_key
from warpvox.design import check_design
from warpvox.errors import ConfigError, SearchError

History = list[tuple[list[Candidate], list[float]]]
OURS = [name for name in ALGORITHMS if name != "custom"]
NEEDS = {"map_elites": pytest.mark.skipif(find_spec("ribs") is None, reason="needs the extra 'search'")}
EVERY = pytest.mark.parametrize("algorithm", [pytest.param(name, marks=NEEDS.get(name, ())) for name in OURS])
QUICK = {"bo": {"optimizer_restarts": 1, "optimizer_iterations": 5, "candidates": 40}}
"""Turns, seeds and records are the same with a hasty fit."""
BUDGET = 20
"""Evaluations: two generations of eight and half of one."""


def fresh(algorithm: str, shape: tuple[int, int] = (5, 5), seed: int = 0, **changes: object) -> BaseSearch:
    small = {"population": 8, "max_evaluations": BUDGET, **QUICK.get(algorithm, {})}
    settings = ALGORITHMS[algorithm](**{**small, **changes})
    search = make_search(settings, shape, seed)
    assert isinstance(search, BaseSearch)
    return search


def actuators(body: np.ndarray) -> float:
    return float((body >= 3).mean() - 0.3 * (body == 1).mean())


def run(search: BaseSearch, fitness: Callable[[np.ndarray], float] = actuators, generations: int = 10**6) -> History:
    history: History = []
    while len(history) < generations and (asked := search.ask()):
        told = [fitness(candidate.body) for candidate in asked]
        search.tell(told)
        history.append((asked, told))
    return history


@cache
def whole(algorithm: str) -> History:
    """A search from its first to its last generation."""
    return run(fresh(algorithm))


def told_apart(history: History) -> list[tuple]:
    return [(c.id, body_key(c.body), c.parents, c.origin, c.generation) for asked, _ in history for c in asked]


@EVERY
@pytest.mark.parametrize("shape", [(5, 5), (5, 7)])
def test_every_design_is_valid_and_new_and_the_budget_is_spent(algorithm: str, shape: tuple[int, int]) -> None:
    history = run(fresh(algorithm, shape))
    candidates = [candidate for asked, _ in history for candidate in asked]
    assert len(candidates) == BUDGET
    assert len({body_key(candidate.body) for candidate in candidates}) == BUDGET
    assert [candidate.id for candidate in candidates] == list(range(BUDGET))
    for generation, (asked, _) in enumerate(history):
        assert 0 < len(asked) <= 8
        for candidate in asked:
            assert candidate.generation == generation
            assert candidate.body.shape == shape
            assert candidate.body.dtype == np.int8
            assert np.array_equal(check_design(candidate.body), candidate.body)


@EVERY
def test_the_family_tree_is_true(algorithm: str) -> None:
    candidates = [candidate for asked, _ in whole(algorithm) for candidate in asked]
    for candidate in candidates:
        assert all(candidates[parent].generation < candidate.generation for parent in candidate.parents)
        if candidate.origin == "random":
            assert candidate.parents == ()
        if candidate.origin == "mutation":
            assert len(candidate.parents) == 1
    assert {candidate.origin for candidate in candidates if candidate.generation == 0} == {"random"}
    assert algorithm == "random" or any(candidate.origin != "random" for candidate in candidates)


@EVERY
def test_same_seed_and_fitness_same_proposals(algorithm: str) -> None:
    one = told_apart(run(fresh(algorithm, seed=5), generations=3))
    random.seed(99)
    np.random.seed(99)
    assert told_apart(run(fresh(algorithm, seed=5), generations=3)) == one
    other = told_apart(run(fresh(algorithm, seed=6), generations=3))
    assert [entry[1] for entry in other] != [entry[1] for entry in one]


@EVERY
def test_fitness_matters(algorithm: str) -> None:
    one, other = told_apart(whole(algorithm)), told_apart(run(fresh(algorithm), lambda body: -actuators(body)))
    assert one[:8] == other[:8]
    assert (one == other) == (algorithm == "random")


@EVERY
def test_no_global_generator_is_touched(algorithm: str) -> None:
    import torch

    random.seed(1)
    np.random.seed(1)
    torch.manual_seed(1)
    threads = torch.get_num_threads()
    before = random.getstate(), np.random.get_state(), torch.get_rng_state()
    run(fresh(algorithm), generations=3)
    assert random.getstate() == before[0]
    assert all(np.array_equal(a, b) for a, b in zip(np.random.get_state(), before[1], strict=True))
    assert torch.equal(torch.get_rng_state(), before[2])
    assert torch.get_num_threads() == threads
    assert torch.get_default_dtype() == torch.float32


@EVERY
def test_two_searches_do_not_disturb_each_other(algorithm: str) -> None:
    alone = told_apart(run(fresh(algorithm), generations=3))
    one, other = fresh(algorithm), fresh(algorithm, seed=9)
    mixed: History = []
    for _ in range(3):
        mixed += run(one, generations=1)
        run(other, generations=1)
    assert told_apart(mixed) == alone


# ------------------------------------------------------------------------------------------------------ turns


@EVERY
def test_asking_twice_is_an_error(algorithm: str) -> None:
    search = fresh(algorithm)
    asked = search.ask()
    with pytest.raises(SearchError, match=r"ask\(\) was called twice: tell\(\) .* 8 candidates of generation 0"):
        search.ask()
    search.tell([0.0] * len(asked))


@EVERY
def test_telling_without_asking_is_an_error(algorithm: str) -> None:
    search = fresh(algorithm)
    with pytest.raises(SearchError, match=r"tell\(\) was called without ask\(\)"):
        search.tell([])


@EVERY
@pytest.mark.parametrize(
    ("fitness", "words"),
    [
        ([1.0] * 7, "expected 8, got 7"),
        ([1.0] * 3 + [float("nan")] + [1.0] * 4, "candidate 3 must be a finite number, got nan"),
        ([float("-inf")] * 8, "candidate 0 must be a finite number, got -inf"),
    ],
)
def test_bad_fitness_is_refused_and_can_be_told_again(algorithm: str, fitness: list[float], words: str) -> None:
    search = fresh(algorithm)
    asked = search.ask()
    with pytest.raises(SearchError, match=words):
        search.tell(fitness)
    search.tell([actuators(candidate.body) for candidate in asked])
    undisturbed = fresh(algorithm)
    run(undisturbed, generations=1)
    assert told_apart(run(search, generations=1)) == told_apart(run(undisturbed, generations=1))


@EVERY
def test_a_candidates_body_may_be_painted_over(algorithm: str) -> None:
    search, undisturbed = fresh(algorithm), fresh(algorithm)
    told = [actuators(candidate.body) for candidate in undisturbed.ask()]
    undisturbed.tell(told)
    for candidate in search.ask():
        candidate.body[:] = 0
    search.tell(told)
    assert told_apart(run(search, generations=1)) == told_apart(run(undisturbed, generations=1))


@EVERY
def test_a_spent_search_asks_for_nothing(algorithm: str) -> None:
    search = fresh(algorithm)
    run(search)
    assert search.ask() == []
    assert search.ask() == []


@EVERY
def test_a_budget_below_the_population_is_one_short_generation(algorithm: str) -> None:
    history = run(fresh(algorithm, max_evaluations=3))
    assert [len(asked) for asked, _ in history] == [3]


@EVERY
def test_equal_fitness_everywhere_is_no_obstacle(algorithm: str) -> None:
    assert sum(len(asked) for asked, _ in run(fresh(algorithm), lambda body: 1.5)) == BUDGET


# ----------------------------------------------------------------------------------------------------- replay


@EVERY
@pytest.mark.parametrize("after", [0, 1, 2])
def test_a_replayed_search_goes_on_as_the_first(algorithm: str, after: int) -> None:
    history = whole(algorithm)
    search = fresh(algorithm)
    search.replay(history[:after])
    assert search.generation == after
    assert told_apart(run(search)) == told_apart(history[after:])


@EVERY
def test_replay_wants_a_fresh_search(algorithm: str) -> None:
    search = fresh(algorithm)
    history = run(search, generations=1)
    with pytest.raises(SearchError, match="fresh search"):
        search.replay(history)


@EVERY
def test_a_foreign_history_is_refused(algorithm: str) -> None:
    history = run(fresh(algorithm, shape=(5, 7)), generations=2)
    with pytest.raises(SearchError, match="not of this search"):
        fresh(algorithm).replay(history)


@EVERY
def test_a_history_without_its_beginning_is_refused(algorithm: str) -> None:
    history = run(fresh(algorithm), generations=3)
    with pytest.raises(SearchError, match="not of this search"):
        fresh(algorithm).replay(history[1:])


# ------------------------------------------------------------------------------------------------- the arguments


@pytest.mark.parametrize("shape", [(5,), (0, 5), (5, 5.0), "55", 5])
def test_bad_shapes_are_told(shape: object) -> None:
    with pytest.raises(ConfigError, match="two integers"):
        fresh("ga", shape)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", [-1, 0.5, None, True])
def test_bad_seeds_are_told(seed: object) -> None:
    with pytest.raises(ConfigError, match="seed must be an integer >= 0"):
        fresh("ga", seed=seed)  # type: ignore[arg-type]


@EVERY
def test_a_shape_with_too_few_bodies_is_told_at_once(algorithm: str) -> None:
    with pytest.raises(ConfigError, match=r"only 16 valid bodies of 1x2: .* max_evaluations=8 at most"):
        fresh(algorithm, shape=(1, 2), max_evaluations=30)


@EVERY
def test_half_of_all_bodies_of_a_tiny_shape_can_be_had(algorithm: str) -> None:
    history = run(fresh(algorithm, shape=(1, 3), max_evaluations=43))
    assert len({body_key(candidate.body) for asked, _ in history for candidate in asked}) == 43
