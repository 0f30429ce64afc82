"""Intervals and aggregates over tasks against scipy's, values by hand, and what intervals promise."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats

from warpvox.algos.statistics import (
    bootstrap,
    difference,
    improvement,
    interquartile_mean,
    interval,
    mean,
    mean_interval,
    optimality_gap,
    profile,
)

RUNS = st.lists(st.floats(-10, 10), min_size=1, max_size=7).map(np.array)
SCORES = st.dictionaries(st.sampled_from("abcd"), RUNS, min_size=1)


@settings(max_examples=40)
@given(SCORES)
def test_the_middle_half_is_scipys_trimmed_mean(scores: dict[str, np.ndarray]) -> None:
    runs = np.concatenate(list(scores.values()))
    assert interquartile_mean(scores) == pytest.approx(stats.trim_mean(runs, 0.25), abs=1e-9)
    assert mean(scores) == pytest.approx(runs.mean(), abs=1e-9)


@settings(max_examples=40)
@given(SCORES, SCORES)
def test_improvement_is_the_mann_whitney_statistic(first: dict, second: dict) -> None:
    tasks = first.keys() & second.keys()
    if not tasks:
        with pytest.raises(ValueError, match="no task in common"):
            improvement(first, second)
        return
    pairs = [stats.mannwhitneyu(first[t], second[t], method="asymptotic").statistic for t in sorted(tasks)]
    sizes = [len(first[t]) * len(second[t]) for t in sorted(tasks)]
    assert improvement(first, second) == pytest.approx(np.mean(np.divide(pairs, sizes)))
    assert improvement(first, second) + improvement(second, first) == pytest.approx(1.0)


def test_profile_and_gap_by_hand() -> None:
    scores = {"a": np.array([0.0, 0.5]), "b": np.array([1.5])}
    assert profile(scores, np.array([-1, 0, 0.4, 0.5, 2])).tolist() == [1, 2 / 3, 2 / 3, 1 / 3, 0]
    assert optimality_gap(scores) == pytest.approx((1 + 0.5 + 0) / 3)
    share, low, high = bootstrap(lambda drawn: profile(drawn, np.array([0.4])), scores)
    # one task has a single run, which every sample holds: a third at least, all at most
    assert (share[0], low[0], high[0]) == (2 / 3, 1 / 3, 1)


def test_runs_are_drawn_within_their_task() -> None:
    scores = {"a": np.full(3, 1.0), "b": np.full(2, 5.0)}
    assert interval(mean, scores) == interval(mean, scores)
    found = interval(mean, scores)  # a sample that mixed the tasks would have another mean
    assert (found.mean, found.low, found.high, found.n) == pytest.approx((2.6, 2.6, 2.6, 5))
    assert np.isnan(interval(mean, {"a": np.array([1.0]), "b": np.array([2.0])}).low)


def test_the_promise_is_kept() -> None:
    """Intervals over four tasks of known means, with many runs: percentile intervals are too short for few."""
    rng = np.random.default_rng(0)
    hits, repeats = 0, 400
    for _ in range(repeats):
        scores = {task: task + rng.normal(0.0, 0.5, 25) for task in range(4)}
        found = interval(mean, scores, samples=400)
        hits += found.low <= 1.5 <= found.high
    assert abs(hits / repeats - 0.95) < 0.045  # four standard deviations of such a share


VALUES = st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=20)


@given(VALUES, st.sampled_from([0.5, 0.9, 0.95, 0.99]))
def test_student(values: list[float], level: float) -> None:
    interval = mean_interval(values, level)
    assert (interval.n, interval.mean) == (len(values), pytest.approx(np.mean(values)))
    error = stats.sem(values)
    if error > 1e-9:
        expected = stats.t.interval(level, len(values) - 1, np.mean(values), error)
        assert (interval.low, interval.high) == pytest.approx(expected, rel=1e-6, abs=1e-9)


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
    with pytest.raises(ValueError, match="a list of values"):
        mean_interval([])


def test_the_promise_of_one_interval_is_kept() -> None:
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(2000):
        interval = mean_interval(rng.normal(5.0, 2.0, 4))
        hits += interval.low <= 5.0 <= interval.high
    assert abs(hits / 2000 - 0.95) < 0.02  # four standard deviations of such a share
