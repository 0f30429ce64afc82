"""The figures of ``warpvox bench suite=precision``."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from warpvox.bench import precision


def test_differences_are_relative_to_the_spread():
    exact = np.array([1.0, 2.0, 4.0, 5.0])
    row = precision.compare(exact, exact + np.array([0.1, 0.1, 0.1, 0.5]))
    assert row["mean_difference"] == pytest.approx(0.2)
    assert row["mean_of_range"] == pytest.approx(0.05)
    assert row["median_difference"] == pytest.approx(0.1)
    assert row["median_of_range"] == pytest.approx(0.025)
    assert row["median_relative"] == pytest.approx((0.05 + 0.1) / 2)
    assert row["rank_correlation"] == pytest.approx(1.0)
    assert precision.compare(exact, exact[::-1])["rank_correlation"] == pytest.approx(-1.0)


def test_the_suite_at_a_tiny_size(warpvox: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(precision, "HORIZONS", (1, 2))
    monkeypatch.setattr(precision, "LARGE", 4)
    monkeypatch.setattr(precision, "FAR", 20)
    outcome = warpvox("bench", "suite=precision", "designs=2")
    assert outcome.code == 0, outcome.err
    (folder,) = Path("outputs/bench/precision").iterdir()
    figures = json.loads((folder / "summary.json").read_text())
    assert len(figures["drift"]) == 3
    for found in figures["drift"].values():
        # more noise, more distance; and float32 is not float64
        assert found["float64, actions + 1e-10"]["most"][0] < found["float64, actions + 1e-07"]["most"][0] < 1e-7
        assert 0 < found["float32"]["most"][0] < 1e-7
    assert set(figures["returns"]) == {"sine", "noise"}
