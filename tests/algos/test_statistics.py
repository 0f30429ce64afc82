"""Intervals against scipy's, values by hand, and what intervals promise."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats

from warpvox.algos.statistics import difference, mean_interval

VALUES = st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=20)


@given(VALUES, VALUES)
def test_welch(first: list[float], second: list[float]) -> None:
    interval = difference(first, second)
    if min(np.std(first), np.std(second)) > 1e-6:
        expected = stats.ttest_ind(first, second, equal_var=False).confidence_interval(0.95)
        assert (interval.low, interval.high) == pytest.approx((expected.low, expected.high), rel=1e-6, abs=1e-6)
    opposite = difference(second, first)
    assert (interval.low, interval.high) == pytest.approx((-opposite.high, -opposite.low))


def test_a_single_value_tells_nothing_of_others() -> None:
    assert math.isnan(mean_interval([3.0]).low)
    assert math.isnan(difference([3.0], [1.0, 2.0]).high)
    assert str(mean_interval([3.0])) == "3.000"
    assert difference([1.0, 1.0], [3.0, 3.0]).high == -2.0
    with pytest.raises(ValueError):
        mean_interval([])


def test_the_promise_is_kept() -> None:
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(2000):
        interval = mean_interval(rng.normal(5.0, 2.0, 4))
        hits += interval.low <= 5.0 <= interval.high
    assert abs(hits / 2000 - 0.95) < 0.02  # four standard deviations of such a share
