"""Means with confidence intervals by Student's t distribution."""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

LEVEL = 0.95
"""Default confidence level."""


@dataclass(frozen=True)
class Interval:
    """A mean or a difference of means, with confidence interval and sample size.

    ``low`` and ``high`` are NaN where there are too few values.
    """

    mean: float
    low: float
    high: float
    n: int

    def __str__(self) -> str:
        """Format the mean and the interval, if known, with three decimals."""
        known = math.isfinite(self.low)
        return f"{self.mean:.3f}" + (f" [{self.low:.3f}, {self.high:.3f}]" if known else "")


def mean_interval(values: Sequence[float] | np.ndarray, level: float = LEVEL) -> Interval:
    """Return the mean of independent values with Student's confidence interval.

    ValueError: there are no values.
    """
    from scipy import stats  # slow to import

    data = _float_values(values)
    n = len(data)
    mean = float(data.mean())
    if n < 2:
        return Interval(mean, math.nan, math.nan, n)
    error = float(data.std(ddof=1)) / math.sqrt(n)
    if error == 0:
        return Interval(mean, mean, mean, n)
    low, high = stats.t.interval(level, n - 1, mean, error)
    return Interval(mean, float(low), float(high), n)


def difference(first: Sequence[float], second: Sequence[float], level: float = LEVEL) -> Interval:
    """Return the mean of ``first`` minus the mean of ``second``, with Welch's interval for unequal variances.

    ``n`` is the smaller number of values. ValueError: there are no values.
    """
    from scipy import stats  # slow to import

    a = _float_values(first)
    b = _float_values(second)
    n = min(len(a), len(b))
    mean = float(a.mean() - b.mean())
    if n < 2:
        return Interval(mean, math.nan, math.nan, n)
    if a.std() == b.std() == 0:
        return Interval(mean, mean, mean, n)
    with warnings.catch_warnings(), np.errstate(divide="ignore", invalid="ignore"):
        # SciPy warns about the p value of nearly equal values, which is not used.
        warnings.simplefilter("ignore", RuntimeWarning)
        test: Any = stats.ttest_ind(a, b, equal_var=False)
        low, high = test.confidence_interval(level)
    return Interval(mean, float(low), float(high), n)


def _float_values(values: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the values as float64 ``[n]``; ValueError: empty or not a list."""
    data = np.asarray(values, dtype=np.float64)
    if data.ndim != 1 or not len(data):
        raise ValueError(f"a mean needs a list of values, got an array of shape {data.shape}")
    return data
