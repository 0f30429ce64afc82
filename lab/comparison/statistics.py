"""Statistics over several tasks and few seeds, after Agarwal et al. (2021), arXiv:2108.13264.

Scores of a search are a mapping from tasks to float64 ``[..., runs]``; tasks need not have equally many runs. Leading
dimensions are those of bootstrap samples.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

Scores = Mapping[str, np.ndarray]
SAMPLES = 2000
"""Number of bootstrap samples for an interval."""
LEVEL = 95.0
"""Confidence level of intervals, in percent."""


def interquartile_mean(scores: Scores) -> np.ndarray:
    """Compute the mean of the middle half of all runs of all tasks."""
    runs = np.sort(np.concatenate([np.asarray(values, np.float64) for values in scores.values()], axis=-1), axis=-1)
    cut = runs.shape[-1] // 4
    return runs[..., cut : runs.shape[-1] - cut].mean(-1)


def improvement(first: Scores, second: Scores) -> np.ndarray:
    """Compute the probability that a run of ``first`` beats one of ``second`` on the same task; ties count half.

    The mean over the tasks of both of the Mann-Whitney statistic, divided by the number of pairs.
    """
    parts = []
    for task in first:
        if task in second:
            a = np.asarray(first[task])[..., :, None]
            b = np.asarray(second[task])[..., None, :]
            parts.append(((a > b) + 0.5 * (a == b)).mean((-2, -1)))
    return np.mean(parts, axis=0)


def interval(statistic: Callable[..., np.ndarray], *searches: Scores) -> tuple[float, float, float]:
    """Compute a statistic of scores with its stratified bootstrap interval.

    Runs are drawn with replacement within each task of each search; the interval lies between percentiles of the
    statistic of such draws. It is NaN where every task has one run. Equal arguments give equal intervals.
    """
    rng = np.random.default_rng(0)
    samples = []
    most_runs = 0
    for scores in searches:
        drawn = {}
        for task, values in scores.items():
            runs = np.asarray(values, np.float64)
            drawn[task] = runs[rng.integers(len(runs), size=(SAMPLES, len(runs)))]
            most_runs = max(most_runs, len(runs))
        samples.append(drawn)
    tail = (100 - LEVEL) / 2
    low, high = np.percentile(statistic(*samples), (tail, 100 - tail))
    if most_runs < 2:
        low = high = np.nan
    return float(statistic(*searches)), float(low), float(high)


def interval_text(found: tuple[float, float, float]) -> str:
    value, low, high = found
    return f"{value:.3f} [{low:.3f}, {high:.3f}]" if np.isfinite(low) else f"{value:.3f}"
