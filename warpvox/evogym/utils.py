"""Constants, sampling of robots and small helpers under the names of EvoGym's module ``evogym.utils``."""

from __future__ import annotations

import operator
import random
import time
from bisect import bisect_left
from collections.abc import Callable
from itertools import accumulate
from typing import Optional, Tuple  # noqa: UP035  # scripts take these from here

import numpy as np

from warpvox import design
from warpvox.checks import check_shape
from warpvox.errors import DesignError
from warpvox.evogym.errors import ArgumentTypeError, RangeError
from warpvox.types import Cell

# EvoGym's modules have no __all__: scripts that say `from evogym import *` also get what the modules import.
__all__ = ["BASELINE_ENV_NAMES", "VOXEL_TYPES", "Optional", "Pair", "Timer", "Tuple", "draw", "get_full_connectivity"]
__all__ += ["get_uniform", "has_actuator", "hashable", "is_connected", "np", "random", "sample_robot", "time"]

VOXEL_TYPES = {cell.name: int(cell) for cell in Cell}
"""Types of cells: EMPTY 0, RIGID 1, SOFT 2, H_ACT 3, V_ACT 4, FIXED 5."""

BASELINE_ENV_NAMES = [
    *("Walker-v0", "BridgeWalker-v0", "BidirectionalWalker-v0"),
    *("Carrier-v0", "Carrier-v1", "Pusher-v0", "Pusher-v1", "Thrower-v0", "Catcher-v0"),
    *("BeamToppler-v0", "BeamSlider-v0", "Lifter-v0"),
    *("Climber-v0", "Climber-v1", "Climber-v2"),
    *("UpStepper-v0", "DownStepper-v0", "ObstacleTraverser-v0", "ObstacleTraverser-v1", "Hurdler-v0"),
    *("PlatformJumper-v0", "GapJumper-v0", "Traverser-v0", "CaveCrawler-v0"),
    *("AreaMaximizer-v0", "AreaMinimizer-v0", "WingspanMazimizer-v0", "HeightMaximizer-v0"),
    *("Flipper-v0", "Jumper-v0", "Balancer-v0", "Balancer-v1"),
]
"""Ids of the benchmark's tasks, in the release's order and spelling."""


def get_uniform(x: int) -> np.ndarray:
    """Return the uniform distribution over ``x`` outcomes, float64 ``[x]``; RangeError: ``x`` is not positive."""
    if x <= 0:
        raise RangeError(f"A distribution needs at least one outcome, got size {x}.")
    return np.full(x, 1.0) / x


def draw(pd: np.ndarray) -> int:
    """Sample an index with relative weights ``pd`` from Python's generator ``random``; errors as of ``_drawer``."""
    return _drawer(pd)()


def _drawer(pd: object) -> Callable[[], int]:
    """Return a function that samples indices exactly as the release does from the same state of ``random``.

    RangeError: no weights, a negative one, or all 0.
    """
    weights = np.array(pd)
    if weights.size == 0 or not np.all(weights >= 0) or not weights.sum() > 0:
        raise RangeError(f"Weights must be at least one number >= 0, and not all 0, got {pd!r}.")
    up_to = list(accumulate((weights / weights.sum()).tolist()))
    last = int(np.flatnonzero(weights)[-1])  # where rounding leaves the sum below 1
    return lambda: min(bisect_left(up_to, random.uniform(0, 1)), last)


def sample_robot(robot_shape: tuple[int, int], pd: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Sample a valid robot (connected, with an actuator) by rejection, from Python's global generator ``random``.

    Args:
        robot_shape: rows and columns.
        pd: relative weights ``[5]`` of empty, rigid, soft, horizontal and vertical actuator cells; default
            (0.6, 0.2, 0.2, 0.2, 0.2).

    Returns:
        Cells float64 ``[rows, columns]``, row 0 on top, and their connections ``[2, k]``.

    Raises:
        RangeError: other than two sizes, or five weights. DesignError: weights that cannot give an actuator.
    """
    weights = np.asarray(design.SAMPLING_WEIGHTS if pd is None else pd)
    if weights.shape != (5,):
        raise RangeError(f"pd must hold five weights (empty, rigid, soft, h_act, v_act), got shape {weights.shape}.")
    if weights[Cell.H_ACT] + weights[Cell.V_ACT] == 0:
        raise DesignError(f"A robot needs an actuator, but pd gives both kinds the weight 0: {pd!r}.")
    rows, columns = check_shape("robot_shape", robot_shape, RangeError)
    pick = _drawer(weights)
    while True:
        robot = np.array([pick() for _ in range(rows * columns)], float).reshape(rows, columns)
        if has_actuator(robot) and is_connected(robot):
            return robot, get_full_connectivity(robot)


def is_connected(robot: np.ndarray) -> bool:
    """Return whether all non-empty cells are connected along edges; False for an empty body."""
    return bool(design.count_pieces(design.as_grid(robot)) == 1)


def has_actuator(robot: np.ndarray) -> bool:
    """Return whether any cell is an actuator."""
    return design.has_actuator(robot)


def get_full_connectivity(robot: np.ndarray) -> np.ndarray:
    """List all pairs of adjacent non-empty cells as flat indices, ``[2, k]``."""
    pairs = design.full_connections(robot)
    return pairs.T.astype(np.int64) if len(pairs) else np.empty((2, 0))


def hashable(robot: np.ndarray) -> str:
    """Encode the cells as a string of digits, row by row from the top."""
    return "".join(str(int(cell)) for cell in np.ravel(robot))


class Timer:
    """Limits a loop to a target number of rounds per second.

    Args:
        target_step_frequency: steps per second; None: as often as possible.
    """

    def __init__(self, target_step_frequency: int | None = None) -> None:
        self._target = target_step_frequency
        self._begin = time.monotonic()
        self._steps = self._all_steps = self.total_count = 0

    def should_step(self) -> bool:
        """Return whether enough time has passed for the next step."""
        # As released, one step a second less than asked for.
        return self._target is None or self._steps < (self._target - 1) * (time.monotonic() - self._begin)

    def step(self, verbose: bool = False) -> None:
        """Count a step; once a second, print the rate if ``verbose``."""
        self._steps += 1
        if time.monotonic() - self._begin > 1:
            self._all_steps = self._all_steps + self._steps
            self.total_count = self.total_count + 1
            if verbose:
                print(f"rps: {self._steps} | avg rps: {self._all_steps / self.total_count:.2f}")
            self._begin = self._begin + 1
            self._steps = 0


def _in_parallel(verb: str, result: Callable[[int, int], int]) -> Callable[[Pair, int | Pair], Pair]:
    """Build an operator of pairs that applies ``result`` to x and to y separately."""

    def calculate(self: Pair, other: int | Pair) -> Pair:
        x, y = (other.x, other.y) if isinstance(other, Pair) else (other, other)
        if not isinstance(x, int):
            raise ArgumentTypeError(f"Cannot {verb} a Pair and {other!r} of type {type(other).__name__}.")
        return Pair(result(self.x, x), result(self.y, y))

    return calculate


class Pair:
    """Two integers, x and y, with element-wise arithmetic (division rounds down).

    ArgumentTypeError: other than integers.
    """

    __slots__ = ("x", "y")

    def __init__(self, x: int, y: int) -> None:
        for value in (x, y):
            if not isinstance(value, int | np.integer):
                raise ArgumentTypeError(f"A Pair holds integers, got {value!r} of type {type(value).__name__}.")
        self.x = int(x)
        self.y = int(y)

    def __getitem__(self, key: int) -> int:
        if key not in (0, 1):
            raise IndexError(f"A Pair has the entries 0 and 1, got {key!r}.")
        return self.y if key else self.x

    __add__ = _in_parallel("add", operator.add)
    __sub__ = _in_parallel("subtract", operator.sub)
    __mul__ = _in_parallel("multiply", operator.mul)
    __truediv__ = __floordiv__ = _in_parallel("divide", operator.floordiv)
    __mod__ = _in_parallel("take the remainder of", operator.mod)
    each_max = _in_parallel("compare", max)
    each_min = _in_parallel("compare", min)

    def __eq__(self, other: object) -> bool:
        x, y = (other.x, other.y) if isinstance(other, Pair) else (other, other)
        return isinstance(x, int) and (self.x, self.y) == (x, y)

    def __hash__(self) -> int:
        return hash((self.x, self.y))

    def abs(self) -> Pair:
        """Return the pair of absolute values."""
        return Pair(abs(self.x), abs(self.y))

    def copy(self) -> Pair:
        """Copy the pair."""
        return Pair(self.x, self.y)

    __copy__ = copy

    def __str__(self) -> str:
        return f"({self.x}, {self.y})"

    def __repr__(self) -> str:
        return f"Pair{self}"
