"""Means with their confidence intervals, by Student's t distribution."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

LEVEL = 0.95
"""Default confidence level."""


@dataclass(frozen=True)
class Interval:
    """A mean (or a difference of two), its confidence interval, and how many values it is of.

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
