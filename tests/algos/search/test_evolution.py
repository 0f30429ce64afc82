"""Evolution of bodies and gaits: who becomes a parent, and what its children are."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from warpvox.algos.candidate import GAIT, Candidate
from warpvox.algos.search import EvolutionSettings, make_search
from warpvox.algos.search.bodies import body_key
from warpvox.errors import ConfigError


def evolve(fitness: Callable[[Candidate], float], **changes: object) -> tuple[object, list[Candidate], list[bool]]:
    """A search at its end, all its candidates, and whether each was wanted."""
    settings = EvolutionSettings(**{"children": 12, "max_evaluations": 96, "population": 6, **changes})
    search, candidates, wanted = make_search(settings, (4, 4), seed=3), [], []
    while asked := search.ask():
        values = [fitness(candidate) for candidate in asked]
        wanted += [search.wanted(*pair) for pair in zip(asked, values, strict=True)]
        candidates += asked
        search.tell(values)
    return search, candidates, wanted


def luck(candidate: Candidate) -> float:
    """Another number for each candidate, whatever its body is."""
    return float(np.random.default_rng(candidate.id).random())


def test_parents_are_the_best_of_all_so_far_and_few_of_them_share_a_body() -> None:
    search, candidates, _ = evolve(luck, per_body=2, newcomers=0.0)
    (parents,) = search.islands
    bodies: Counter[bytes] = Counter()
    expected = []
    for candidate in sorted(candidates, key=luck, reverse=True):
        bodies[body_key(candidate.body)] += 1
        if bodies[body_key(candidate.body)] <= 2 and len(expected) < 6:
            expected.append(candidate.id)
    assert parents == expected


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_children_have_their_parents_body_or_a_mutant_of_it(share: float) -> None:
    _, candidates, _ = evolve(luck, same_body=share, newcomers=0.0)
    children = [candidate for candidate in candidates if candidate.generation]
    assert {child.origin for child in children} == {GAIT if share else "mutation"}
    for child in children:
        (parent,) = child.parents
        assert np.array_equal(child.body, candidates[parent].body) == bool(share)


@pytest.mark.parametrize("islands", [1, 3])
def test_all_parents_were_wanted(islands: int) -> None:
    """What a child inherits must have been kept."""
    _, candidates, wanted = evolve(luck, islands=islands, migration=2)
    parents = {parent for candidate in candidates for parent in candidate.parents}
    assert parents
    assert all(wanted[parent] for parent in parents)
    assert not all(wanted)


def test_islands_exchange_their_best_only_every_so_many_generations() -> None:
    # the first candidate of all is the best there will ever be
    def first(candidate: Candidate) -> float:
        return 2.0 if candidate.id == 0 else luck(candidate)

    alone, *_ = evolve(first, islands=2, migration=1000)
    mixed, *_ = evolve(first, islands=2, migration=3)
    assert [0 in parents for parents in alone.islands] == [True, False]
    assert [0 in parents for parents in mixed.islands] == [True, True]


def test_more_islands_than_parents_or_children_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"islands must be at most 6, .*\(population=6\).*\(children=12\); got 7"):
        EvolutionSettings(children=12, population=6, islands=7)
