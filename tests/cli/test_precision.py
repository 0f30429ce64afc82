"""The figures of ``warpvox bench suite=precision``."""

import numpy as np
import pytest

from warpvox.cli.benchmarks.precision import compare


def test_differences_are_relative_to_the_spread():
    exact = np.array([0.0, 1.0, 2.0, 5.0])
    row = compare(exact, exact + 0.1)
    assert row["mean_difference"] == pytest.approx(0.1)
    assert row["of_range"] == pytest.approx(0.02)
    assert row["of_deviation"] == pytest.approx(0.1 / exact.std())
    assert row["rank_correlation"] == pytest.approx(1.0)
    assert compare(exact, exact[::-1])["rank_correlation"] == pytest.approx(-1.0)
