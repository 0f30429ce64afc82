"""What holds for every search: valid and unique designs, turns, budget, seeds, replay, a true family tree."""

import random
from functools import cache, partial

import codesign_toys
import numpy as np
import pytest
from codesign_toys import EVERY, HASTY, History
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from refusals import refused

from warpvox.algos.candidate import START, Candidate
from warpvox.algos.search import ALGORITHMS, make_search
from warpvox.algos.search.base import BaseSearch
from warpvox.algos.search.bodies import CELL_TYPES, body_key, count_valid, mutate, neighbours
from warpvox.design import check_design
from warpvox.errors import ConfigError, DesignError, SearchError

BUDGET = 20  # evaluations: two generations of eight and half of one


def fresh(algorithm: str, shape: tuple[int, int] = (5, 5), seed: int = 0, **changes: object) -> BaseSearch:
    small = {"population": 8, "max_designs": BUDGET, **HASTY.get(algorithm, {})}
    settings = ALGORITHMS[algorithm](**{**small, **changes})
    search = make_search(settings, shape, seed)
    assert isinstance(search, BaseSearch)
    return search


def actuators(body: np.ndarray) -> float:
    return float((body >= 3).mean() - 0.3 * (body == 1).mean())


run = partial(codesign_toys.run, fitness=actuators)


@cache
def whole(algorithm: str) -> History:
    return run(fresh(algorithm))


def all_differ(candidates: list[Candidate]) -> bool:
    return len({body_key(candidate.body) for candidate in candidates}) == len(candidates)


def told_apart(history: History) -> list[tuple]:
    return [(c.id, body_key(c.body), c.parents, c.origin, c.generation) for asked, _ in history for c in asked]


@EVERY
@pytest.mark.parametrize("shape", [(5, 5), (5, 7)])
def test_every_design_is_valid_and_new_and_the_budget_is_spent(algorithm: str, shape: tuple[int, int]) -> None:
    history = run(fresh(algorithm, shape))
    candidates = [candidate for asked, _ in history for candidate in asked]
    assert len(candidates) == BUDGET
    assert all_differ(candidates)
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
def test_same_seed_and_fitness_same_proposals_and_no_global_generator_is_touched(algorithm: str) -> None:
    import torch

    random.seed(1)
    np.random.seed(1)
    torch.manual_seed(1)
    threads = torch.get_num_threads()
    before = random.getstate(), np.random.get_state(), torch.get_rng_state()
    search = fresh(algorithm)
    assert told_apart(run(search)) == told_apart(whole(algorithm))
    assert search.ask() == search.ask() == []  # its budget is spent
    assert random.getstate() == before[0]
    assert all(np.array_equal(a, b) for a, b in zip(np.random.get_state(), before[1], strict=True))
    assert torch.equal(torch.get_rng_state(), before[2])
    assert (torch.get_num_threads(), torch.get_default_dtype()) == (threads, torch.float32)
    other = run(fresh(algorithm, seed=6), generations=1)
    assert told_apart(other) != told_apart(whole(algorithm)[:1])


@EVERY
def test_fitness_matters(algorithm: str) -> None:
    one, other = told_apart(whole(algorithm)), told_apart(run(fresh(algorithm), fitness=lambda body: -actuators(body)))
    assert one[:8] == other[:8]
    assert (one == other) == (algorithm == "random")


@EVERY
def test_two_searches_do_not_disturb_each_other(algorithm: str) -> None:
    one, other = fresh(algorithm), fresh(algorithm, seed=9)
    mixed: History = []
    for _ in range(2):
        mixed += run(one, generations=1)
        run(other, generations=1)
    assert told_apart(mixed) == told_apart(whole(algorithm)[:2])


@EVERY
def test_the_first_generation_contains_the_bodies_that_a_search_starts_with(algorithm: str) -> None:
    known = [candidate.body for candidate in whole("random")[0][0][:3]]
    search = fresh(algorithm)
    if not search.takes_start:
        with pytest.raises(ConfigError):
            search.start_with(known)
        return
    search.start_with(known)
    history = run(search)
    first = history[0][0]
    assert [candidate.origin == START for candidate in first] == [True] * 3 + [False] * 5
    assert all(np.array_equal(candidate.body, body) for candidate, body in zip(first, known, strict=False))
    assert sum(len(asked) for asked, _ in history) == BUDGET
    assert all_differ([candidate for asked, _ in history for candidate in asked])
    again = fresh(algorithm)
    again.start_with(known)
    again.replay(history[:2])
    assert told_apart(history[2:]) == told_apart(run(again))
    # a search may consist of them alone
    search = fresh("random", population=3, max_designs=3)
    search.start_with(known)
    assert [candidate.origin for candidate in search.ask()] == [START] * 3


def test_bodies_that_a_search_cannot_start_with_are_refused() -> None:
    bodies = [candidate.body for asked, _ in whole("random") for candidate in asked]
    for wrong, says in [
        (bodies[:9], "start has 9 robots, the first generation 8"),
        ([bodies[0], bodies[0]], "same body twice"),
        ([bodies[0][:, :4]], "shape [5, 4]: expected [5, 5]"),
        ([bodies[0], 0 * bodies[1]], "is empty"),
    ]:
        with refused((ConfigError, DesignError), says):
            fresh("ga").start_with(wrong)


@EVERY
def test_asking_twice_and_telling_without_asking_are_errors(algorithm: str) -> None:
    search = fresh(algorithm)
    with pytest.raises(SearchError):
        search.tell([])
    search.ask()
    with pytest.raises(SearchError):
        search.ask()


BAD_FITNESS = {
    "expected 8, got 7": [1.0] * 7,
    "list of 8 numbers, got ['a'": ["a"] * 8,
    "list of 8 numbers, got 3": 3,
    "candidate 3 must be a finite number, got nan": [1.0] * 3 + [float("nan")] + [1.0] * 4,
    "candidate 0 must be a finite number, got -inf": [float("-inf")] * 8,
}


@EVERY
def test_bad_fitness_is_refused_and_a_candidates_body_may_be_painted_over(algorithm: str) -> None:
    """Neither changes what comes after."""
    search = fresh(algorithm)
    for candidate in search.ask():
        candidate.body[:] = 0
    for words, fitness in BAD_FITNESS.items():
        with refused(SearchError, words):
            search.tell(fitness)
    search.tell(whole(algorithm)[0][1])
    assert told_apart(run(search, generations=1)) == told_apart(whole(algorithm)[1:2])


@EVERY
def test_a_budget_below_the_population_is_one_short_generation(algorithm: str) -> None:
    history = run(fresh(algorithm, max_designs=3))
    assert [len(asked) for asked, _ in history] == [3]


@EVERY
def test_equal_fitness_everywhere_is_no_obstacle(algorithm: str) -> None:
    assert sum(len(asked) for asked, _ in run(fresh(algorithm), fitness=lambda body: 1.5)) == BUDGET


@EVERY
@pytest.mark.parametrize("after", [0, 1, 2])
def test_a_replayed_search_goes_on_as_the_first(algorithm: str, after: int) -> None:
    history = whole(algorithm)
    search = fresh(algorithm)
    search.replay(history[:after])
    assert search.generation == after
    assert told_apart(run(search)) == told_apart(history[after:])


@EVERY
def test_replay_wants_a_fresh_search_and_its_own_history_from_the_beginning(algorithm: str) -> None:
    search = fresh(algorithm)
    search.replay(whole(algorithm)[:1])
    with pytest.raises(SearchError):
        search.replay(whole(algorithm))
    for foreign in (run(fresh(algorithm, shape=(5, 7)), generations=1), whole(algorithm)[1:]):
        with pytest.raises(SearchError):
            fresh(algorithm).replay(foreign)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        *(({"shape": shape}, "two integers") for shape in [(5,), (0, 5), (5, 5.0), "55", 5]),
        *(({"seed": seed}, "seed must be an integer >= 0") for seed in [-1, 0.5, None, True]),
    ],
)
def test_bad_arguments_are_told(changes: dict, words: str) -> None:
    with refused(ConfigError, words):
        fresh("ga", **changes)


@EVERY
def test_a_shape_with_too_few_bodies_is_told_at_once(algorithm: str) -> None:
    with refused(ConfigError, "only 16 valid bodies of 1x2:", "max_designs=8 at most"):
        fresh(algorithm, shape=(1, 2), max_designs=30)


@EVERY
def test_half_of_all_bodies_of_a_tiny_shape_can_be_had(algorithm: str) -> None:
    history = run(fresh(algorithm, shape=(1, 3), max_designs=43))
    candidates = [candidate for asked, _ in history for candidate in asked]
    assert len(candidates) == 43
    assert all_differ(candidates)


SIGMAS = 5  # statistics may stray this many standard deviations: one test in two million would fail by chance


@pytest.mark.parametrize("rate", [0.1, 0.5])
def test_mutation_changes_voxels_at_its_rate_and_to_all_other_types_alike(rate: float) -> None:
    rng = np.random.default_rng(2)
    before = rng.integers(0, CELL_TYPES, (6000, 5, 5)).astype(np.int8)
    after = mutate(rng, before, rate)
    changed = after != before
    assert after.dtype == np.int8
    assert changed.mean() == pytest.approx(rate, abs=SIGMAS * np.sqrt(rate * (1 - rate) / changed.size))
    # independent: the number of changes of a body is binomial
    assert changed.sum((1, 2)).var() == pytest.approx(25 * rate * (1 - rate), rel=0.1)
    for cell in range(CELL_TYPES):
        into = np.bincount(after[changed & (before == cell)], minlength=CELL_TYPES)
        assert into[cell] == 0
        others = np.delete(into, cell) / into.sum()
        assert others == pytest.approx([1 / (CELL_TYPES - 1)] * (CELL_TYPES - 1), abs=SIGMAS * 0.5 / into.sum() ** 0.5)


@given(arrays(np.int8, (2, 2, 3), elements=st.integers(0, CELL_TYPES - 1)))
def test_neighbours_are_all_bodies_one_voxel_away(bodies: np.ndarray) -> None:
    near = neighbours(bodies)
    assert near.shape == (2, 6 * (CELL_TYPES - 1), 2, 3)
    for body, around in zip(bodies, near, strict=True):
        assert ((around != body).sum((1, 2)) == 1).all()
        assert len({body_key(other) for other in around}) == len(around)
        assert around.min() >= 0
        assert around.max() < CELL_TYPES


@pytest.mark.parametrize("cells", [1, 2, 3, 5])
def test_valid_bodies_in_a_row_are_runs_of_cells_with_an_actuator(cells: int) -> None:
    runs = sum((cells - length + 1) * (4**length - 2**length) for length in range(1, cells + 1))
    assert count_valid((1, cells)) == count_valid((cells, 1)) == runs


def test_a_source_of_bodies_can_run_dry() -> None:
    search = fresh("random")
    dry = np.zeros((2000, 5, 5), np.int8)
    assert search.new_body(lambda: dry) is None
    full = np.full((2000, 5, 5), 3, np.int8)
    assert np.array_equal(search.new_body(lambda: full), full[0])
    assert search.new_body(lambda: full, limit=100_000) is None


@pytest.mark.parametrize("known", [0, 1])
def test_few_bodies_are_left_only_where_some_have_been_proposed(known: int) -> None:
    search = fresh("random", shape=(1, 7))
    search.claim(np.full((1, 7), 3, np.int8)) if known else None
    search.new_body = lambda *_: None
    with refused(SearchError, f"after {known} have been proposed:") as caught:
        search.ask()
    assert [words in str(caught.value) for words in ("too few are left", "fewer evaluations")] == [known, known]
