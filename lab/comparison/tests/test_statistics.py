"""Tests of the statistics against scipy, hand-computed values and the coverage of intervals."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import stats

from lab.comparison.statistics import improvement, interquartile_mean, interval

RUNS = st.lists(st.floats(-10, 10), min_size=1, max_size=7).map(np.array)
SCORES = st.dictionaries(st.sampled_from("abcd"), RUNS, min_size=1)


def mean(scores: dict[str, np.ndarray]) -> np.ndarray:
    return np.concatenate(list(scores.values()), axis=-1).mean(-1)


@settings(max_examples=40)
@given(SCORES)
def test_the_middle_half_is_scipys_trimmed_mean(scores: dict[str, np.ndarray]) -> None:
    runs = np.concatenate(list(scores.values()))
    assert interquartile_mean(scores) == pytest.approx(stats.trim_mean(runs, 0.25), abs=1e-9)


@settings(max_examples=40)
@given(SCORES, SCORES)
def test_improvement_is_the_mann_whitney_statistic(first: dict, second: dict) -> None:
    tasks = first.keys() & second.keys()
    if not tasks:
        return
    pairs = [stats.mannwhitneyu(first[t], second[t], method="asymptotic").statistic for t in sorted(tasks)]
    sizes = [len(first[t]) * len(second[t]) for t in sorted(tasks)]
    assert improvement(first, second) == pytest.approx(np.mean(np.divide(pairs, sizes)))
    assert improvement(first, second) + improvement(second, first) == pytest.approx(1.0)


def test_runs_are_drawn_within_their_task() -> None:
    scores = {"a": np.full(3, 1.0), "b": np.full(2, 5.0)}
    # a sample that mixed the tasks would have another mean
    assert interval(mean, scores) == pytest.approx((2.6, 2.6, 2.6))
    assert np.isnan(interval(mean, {"a": np.array([1.0]), "b": np.array([2.0])})[1])


def test_the_promise_is_kept() -> None:
    """Intervals over four tasks of known means, with many runs: percentile intervals are too short for few."""
    rng = np.random.default_rng(0)
    hits, repeats = 0, 200
    for _ in range(repeats):
        scores = {task: task + rng.normal(0.0, 0.5, 25) for task in range(4)}
        _, low, high = interval(mean, scores)
        hits += low <= 1.5 <= high
    assert abs(hits / repeats - 0.95) < 0.065  # four standard deviations of such a share
