"""Constants, sampling and helpers of the drop-in."""

import random

import numpy as np
import pytest
from hypothesis import given, strategies as st

import warpvox.evogym as evogym
from warpvox.design import check_design
from warpvox.envs.registry import released_id, task_ids
from warpvox.evogym.errors import ArgumentTypeError, RangeError


def test_constants() -> None:
    assert evogym.VOXEL_TYPES == {"EMPTY": 0, "RIGID": 1, "SOFT": 2, "H_ACT": 3, "V_ACT": 4, "FIXED": 5}
    assert [released_id(task) for task in task_ids()] == evogym.BASELINE_ENV_NAMES
    assert "WingspanMazimizer-v0" in evogym.BASELINE_ENV_NAMES
    assert evogym.hashable(np.array([[0.0, 3], [5, 1]])) == "0351"


def test_a_star_import_gives_what_the_modules_import() -> None:
    names: dict[str, object] = {}
    exec("from warpvox.evogym import *", names)
    assert names["np"] is np
    assert names["random"] is random
    assert {"EvoWorld", "EvoSim", "EvoViewer", "WorldObject", "Pair", "Timer", "Tuple", "Optional"} <= set(names)


@pytest.mark.parametrize("kind", [RangeError, AssertionError, ValueError])
def test_distributions_are_checked(kind: type[Exception]) -> None:
    for weights in ([], [0, 0], [1, -1]):
        with pytest.raises(kind, match="Weights must be"):
            evogym.draw(np.array(weights))
    with pytest.raises(kind):
        evogym.get_uniform(0)
    with pytest.raises(kind, match="five weights"):
        evogym.sample_robot((3, 3), np.ones(4))


def naive_draw(weights: np.ndarray) -> int:
    """One number of the global generator, compared with the sums of the shares from the first on."""
    place, share = random.uniform(0, 1), 0.0
    for index, weight in enumerate(weights / weights.sum()):
        share += weight
        if place <= share:
            return index
    raise AssertionError


def test_robots_come_from_the_global_generator_cell_by_cell() -> None:
    weights = np.array([0.6, 0.2, 0.2, 0.2, 0.2])
    for seed in range(5):
        random.seed(seed)
        robot, connections = evogym.sample_robot((4, 5))
        after = random.random()
        random.seed(seed)
        while True:
            cells = np.array([naive_draw(weights) for _ in range(20)], float).reshape(4, 5)
            if evogym.is_connected(cells) and evogym.has_actuator(cells):
                break
        assert np.array_equal(robot, cells)
        assert random.random() == after
        assert robot.dtype == float
        assert np.array_equal(connections, evogym.get_full_connectivity(robot))
        check_design(robot)


@given(st.integers(-9, 9), st.integers(-9, 9), st.integers(1, 9), st.integers(1, 9))
def test_pairs_calculate_in_parallel(x: int, y: int, u: int, v: int) -> None:
    a, b = evogym.Pair(x, y), evogym.Pair(u, v)
    assert a + b == evogym.Pair(x + u, y + v)
    assert a - 2 == evogym.Pair(x - 2, y - 2)
    assert a * b == evogym.Pair(x * u, y * v)
    assert a / b == a // b == evogym.Pair(x // u, y // v)
    assert a % b == evogym.Pair(x % u, y % v)
    assert a.abs() == evogym.Pair(abs(x), abs(y))
    assert (a.each_max(b)[0], a.each_min(b)[1]) == (max(x, u), min(y, v))
    assert a.copy() == a
    assert hash(a.copy()) == hash(a)
    assert str(a) == f"({x}, {y})"


def test_pairs_are_of_whole_numbers() -> None:
    with pytest.raises(TypeError, match="integers"):
        evogym.Pair(1.5, 2)
    with pytest.raises(ArgumentTypeError, match="Cannot add"):
        evogym.Pair(1, 2) + "3"
    with pytest.raises(IndexError):
        evogym.Pair(1, 2)[2]
    assert evogym.Pair(3, 3) == 3
    assert evogym.Pair(3, 4) != 3


def test_timers_hold_back(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    now = [0.0]
    monkeypatch.setattr("warpvox.evogym.utils.time.monotonic", lambda: now[0])
    timer, free = evogym.Timer(11), evogym.Timer()
    for step in range(1, 11):
        timer.step()
        free.step()
        assert free.should_step()
        assert not timer.should_step()
        now[0] = step / 10 + 1e-6
        assert timer.should_step()
    timer.step(verbose=True)
    assert capsys.readouterr().out == "rps: 11 | avg rps: 11.00\n"
