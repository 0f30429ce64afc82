"""Means with their confidence intervals, by Student's t distribution, and comparisons over several tasks and few seeds.

The latter after Agarwal et al. (2021), arXiv:2108.13264: scores of an algorithm are a mapping from tasks to float64
``[..., runs]``; tasks need not have equally many runs. Leading dimensions are those of bootstrap samples.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

LEVEL = 0.95
"""Default confidence level."""


@dataclass(frozen=True)
class Interval:
    """A mean (a difference of two, another estimate), its confidence interval, and how many values it is of.

    ``low`` and ``high`` are NaN where there are too few values.
    """

    mean: float
    low: float
    high: float
    n: int

    def __str__(self) -> str:
        known = math.isfinite(self.low)
        return f"{self.mean:.3f}" + (f" [{self.low:.3f}, {self.high:.3f}]" if known else "")


def mean_interval(values: Sequence[float] | np.ndarray, level: float = LEVEL) -> Interval:
    """The mean of independent values, with Student's interval: ``mean -+ t(n - 1) * deviation / sqrt(n)``.

    ValueError: there are no values.
    """
    data = _data(values)
    n, mean = len(data), float(data.mean())
    if n < 2:
        return Interval(mean, math.nan, math.nan, n)
    half = _quantile(n - 1, level) * float(data.std(ddof=1)) / math.sqrt(n)
    return Interval(mean, mean - half, mean + half, n)


def difference(first: Sequence[float], second: Sequence[float], level: float = LEVEL) -> Interval:
    """The mean of ``first`` less that of ``second``, with Welch's interval: their variances need not be equal.

    ``n`` is the smaller number of values. ValueError: there are no values.
    """
    a, b = _data(first), _data(second)
    n, mean = min(len(a), len(b)), float(a.mean() - b.mean())
    if n < 2:
        return Interval(mean, math.nan, math.nan, n)
    parts = [float(data.var(ddof=1)) / len(data) for data in (a, b)]
    total = sum(parts)
    if total == 0:
        return Interval(mean, mean, mean, n)
    shares = (part / total for part in parts)  # whose squares do not vanish as those of tiny variances do
    freedom = 1 / sum(share**2 / (len(data) - 1) for share, data in zip(shares, (a, b), strict=True))
    half = _quantile(freedom, level) * math.sqrt(total)
    return Interval(mean, mean - half, mean + half, n)


def _data(values: Sequence[float] | np.ndarray) -> np.ndarray:
    data = np.asarray(values, dtype=np.float64)
    if data.ndim != 1 or not len(data):
        raise ValueError(f"a mean needs a list of values, got an array of shape {data.shape}")
    return data


def _quantile(freedom: float, level: float) -> float:
    """Standard errors that the interval reaches to each side."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.5 + level / 2))


Scores = Mapping[str, np.ndarray]
SAMPLES = 2000
"""Bootstrap samples of an interval."""


def pool(scores: Scores) -> np.ndarray:
    """The runs of all tasks, float64 ``[..., runs]``."""
    return np.concatenate([np.asarray(values, np.float64) for values in scores.values()], axis=-1)


def mean(scores: Scores) -> np.ndarray:
    """The mean of all runs of all tasks."""
    return pool(scores).mean(-1)


def interquartile_mean(scores: Scores) -> np.ndarray:
    """The mean of the middle half of all runs of all tasks: a quarter of them is left out at either end."""
    runs = np.sort(pool(scores), axis=-1)
    cut = runs.shape[-1] // 4
    return runs[..., cut : runs.shape[-1] - cut].mean(-1)


def optimality_gap(scores: Scores, goal: float = 1.0) -> np.ndarray:
    """The mean shortfall of runs from ``goal``; what is above it does not make up for others."""
    return np.maximum(goal - pool(scores), 0.0).mean(-1)


def profile(scores: Scores, thresholds: np.ndarray) -> np.ndarray:
    """Performance profile ``[..., thresholds]``: the share of all runs whose score is above each threshold."""
    return (pool(scores)[..., None] > np.asarray(thresholds)).mean(-2)


def improvement(first: Scores, second: Scores) -> np.ndarray:
    """The probability that a run of ``first`` is better than one of ``second`` on the same task; ties count half.

    The mean over the tasks of both of the Mann-Whitney statistic, divided by the number of pairs. ValueError: they have
    no task in common.
    """
    tasks = [task for task in first if task in second]
    if not tasks:
        raise ValueError("The algorithms have no task in common.")
    parts = []
    for task in tasks:
        a, b = np.asarray(first[task])[..., :, None], np.asarray(second[task])[..., None, :]
        parts.append(((a > b) + 0.5 * (a == b)).mean((-2, -1)))
    return np.mean(parts, axis=0)


def bootstrap(
    statistic: Callable[..., np.ndarray], *algorithms: Scores, samples: int = SAMPLES
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A statistic of the scores of one or more algorithms, with its stratified bootstrap interval.

    Runs are drawn with replacement within each task of each algorithm; the interval lies between percentiles of the
    statistic of ``samples`` such draws. Equal arguments give equal intervals.

    Args:
        statistic: of this module: takes scores of as many algorithms as there are, keeps leading dimensions.

    Returns:
        The statistic and the two ends of the interval.
    """
    rng = np.random.default_rng(0)
    drawn = [{task: _draw(values, samples, rng) for task, values in scores.items()} for scores in algorithms]
    tail = 50 * (1 - LEVEL)
    low, high = np.percentile(statistic(*drawn), (tail, 100 - tail), axis=0)
    return statistic(*algorithms), low, high


def interval(statistic: Callable[..., np.ndarray], *algorithms: Scores, samples: int = SAMPLES) -> Interval:
    """The :func:`bootstrap` interval of a statistic that is one number; NaN as ends where every task has one run."""
    runs = [len(values) for scores in algorithms for values in scores.values()]
    value, low, high = (float(number) for number in bootstrap(statistic, *algorithms, samples=samples))
    return Interval(value, low, high, sum(runs)) if max(runs) > 1 else Interval(value, np.nan, np.nan, sum(runs))


def _draw(values: np.ndarray, samples: int, rng: np.random.Generator) -> np.ndarray:
    runs = np.asarray(values, np.float64)
    return runs[rng.integers(len(runs), size=(samples, len(runs)))]
