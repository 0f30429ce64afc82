"""Mutation, neighbours and counts of bodies, against plain counting."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from warpvox.algos.search.bodies import CELL_TYPES, body_key, count_valid, first_valid, mutate, neighbours

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
    dry = np.zeros((2000, 5, 5), np.int8)
    assert first_valid(lambda: dry, lambda key: False) is None
    full = np.full((2000, 5, 5), 3, np.int8)
    assert first_valid(lambda: full, lambda key: key == body_key(full[0]), limit=100_000) is None
