"""Evolution of bodies and gaits: who becomes a parent, and what its children are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from warpvox.algos.candidate import GAIT, Candidate
from warpvox.algos.search import EvolutionSettings, make_search


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


def beats(one: tuple[float, int], other: tuple[float, int]) -> bool:
    """Whether a candidate (fitness, generation of its beginning) is as fit and as young as another, or better."""
    return one != other and one[0] >= other[0] and one[1] >= other[1]


def test_parents_are_those_that_no_younger_ones_beat() -> None:
    search, candidates, _ = evolve(luck, newcomers=0.2)
    began = {}
    for one in candidates:
        began[one.id] = began[one.parents[0]] if one.parents else one.generation
    points = {one.id: (luck(one), began[one.id]) for one in candidates}
    unbeaten = [number for number, point in points.items() if not any(beats(other, point) for other in points.values())]
    assert 2 < len(unbeaten) <= 6
    assert set(unbeaten) <= set(search.parents)
    assert len(search.parents) == 6
    assert search.parents == sorted(search.parents, key=lambda number: -points[number][0])


def test_old_lineages_do_not_drive_out_young_ones() -> None:
    """Here fitness grows with age, as it does where all lineages improve alike."""
    search, candidates, _ = evolve(lambda one: -float(one.generation), newcomers=0.3)
    assert len({candidates[number].generation for number in search.parents}) > 3


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_children_have_their_parents_body_or_a_mutant_of_it(share: float) -> None:
    _, candidates, _ = evolve(luck, same_body=share, newcomers=0.0)
    children = [candidate for candidate in candidates if candidate.generation]
    assert {child.origin for child in children} == {GAIT if share else "mutation"}
    for child in children:
        (parent,) = child.parents
        assert np.array_equal(child.body, candidates[parent].body) == bool(share)


def test_all_parents_were_wanted() -> None:
    """What a child inherits must have been kept."""
    _, candidates, wanted = evolve(luck)
    parents = {parent for candidate in candidates for parent in candidate.parents}
    assert parents
    assert all(wanted[parent] for parent in parents)
    assert not all(wanted)
