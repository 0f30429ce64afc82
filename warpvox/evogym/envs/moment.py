"""The terms of tasks for one environment, with numpy: what :mod:`warpvox.envs.terms` says for batches.

A single environment spends more time on starting tensor operations than on the physics, so the terms are written a
second time here, for scalars; a test compares both for every task.
"""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING

import numpy as np

from warpvox.types import AXES

if TYPE_CHECKING:
    from warpvox.evogym.engine import Engine

__all__ = ["OBSERVATIONS", "REWARDS", "TERMINATIONS", "Moment", "convex_hull", "polygon_area", "turn"]


class Moment:
    """What terms ask about one recorded time, in simulator units.

    Args:
        engine: what is simulated. The moment is its present; it can be asked for places, sizes and velocities later,
            too, but for terrain only while it is the present.
    """

    def __init__(self, engine: Engine) -> None:
        self.changes = engine.changes
        self._engine, self._time = engine, engine.time
        self._known: dict[tuple, object] = {}

    def points(self, name: str) -> np.ndarray:
        """``[points, 2]``."""
        return self._engine.positions(self._time, name)

    def com(self, name: str) -> np.ndarray:
        """``[2]``: centre of mass."""
        return self._once(("com", name), lambda: self.points(name).sum(axis=0) / len(self.points(name)))

    def velocity(self, name: str) -> np.ndarray:
        """``[2]``: velocity of the centre of mass."""
        speeds = self._engine.velocities(self._time, name)
        return speeds.sum(axis=0) / len(speeds)

    def orientation(self, name: str) -> float:
        """In [0, 2 pi]."""
        return self._once(("turn", name), lambda: self._engine.orientation(self._time, name))

    def scan(self, name: str, objects: tuple[str, ...], reach: int, up: bool) -> np.ndarray:
        """``[2 reach + 1]``: distances to terrain, 5 voxels at most."""
        return self._engine.scan(name, objects, reach, up)

    def extent(self, name: str) -> np.ndarray:
        """``[2]``: width and height."""
        return self._once(("extent", name), lambda: np.ptp(self.points(name), axis=0))

    def hull(self, name: str) -> float:
        """Area of the convex hull."""
        return self._once(("hull", name), lambda: polygon_area(convex_hull(self.points(name))))

    def _once(self, key: tuple, find):
        if key not in self._known:
            self._known[key] = find()
        return self._known[key]


def convex_hull(points: np.ndarray) -> np.ndarray:
    """Corners ``[k, 2]`` of the convex hull of points ``[n, 2]``, counter-clockwise."""
    corners: list[tuple[float, float]] = []
    for way in (1, -1):  # the lower border to the right, then the upper one to the left
        border: list[tuple[float, float]] = []
        for x, y in sorted(map(tuple, points.tolist()))[::way]:
            while len(border) > 1 and turn(border[-2], border[-1], (x, y)) <= 0:
                border.pop()
            border.append((x, y))
        corners += border[:-1]
    return np.array(corners)


def turn(a: tuple, b: tuple, c: tuple) -> float:
    """Positive if the way from a over b to c turns left."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def polygon_area(corners: np.ndarray) -> float:
    """Area of a polygon ``[k, 2]``, positive if its corners are given counter-clockwise."""
    (x, y), (u, v) = corners.T, np.roll(corners, -1, axis=0).T
    return float((x * v - u * y).sum()) / 2


# --------------------------------------------------------------------------------- observations: ``[k]`` of a state


def shape(now: Moment, name: str) -> np.ndarray:
    return (now.points(name) - now.com(name)).T.flatten()


def floor(now: Moment, name: str, reach: int, objects: tuple[str, ...]) -> np.ndarray:
    return now.scan(name, objects, reach, up=False)


def ceiling(now: Moment, name: str, reach: int, objects: tuple[str, ...]) -> np.ndarray:
    return now.scan(name, objects, reach, up=True)


OBSERVATIONS = {
    "velocity": lambda now, name: now.velocity(name),
    "orientation": lambda now, name: np.array([now.orientation(name)]),
    "shape": shape,
    "separation": lambda now, name, other: now.com(name) - now.com(other),
    "floor": floor,
    "ceiling": ceiling,
}

# ---------------------------------------------------------------------- rewards: of the states before and after a step


def displacement(before: Moment, after: Moment, name: str, axis: str) -> float:
    return after.com(name)[AXES[axis]] - before.com(name)[AXES[axis]]


def drop(before: Moment, after: Moment, name: str, below: float) -> float:
    height = after.com(name)[1]
    return height - before.com(name)[1] if height < below else 0.0


def staged_drop(before: Moment, after: Moment, name: str, below: float, x: float, below_beyond: float) -> float:
    return drop(before, after, name, below if after.com(name)[0] <= x else below_beyond)


def away_from_start(before: Moment, after: Moment, name: str) -> float:
    moved = displacement(before, after, name, "x")
    return moved if after.com(name)[0] >= 0 else -moved


def distance(before: Moment, after: Moment, name: str, axis: str, goal: float) -> float:
    column = AXES[axis]
    return abs(goal - after.com(name)[column]) - abs(goal - before.com(name)[column])


def gap(before: Moment, after: Moment, name: str, other: str, axis: str) -> float:
    now, then = (abs((state.com(name) - state.com(other))[AXES[axis]]) for state in (after, before))
    return now - then


def turned(before: Moment, after: Moment, name: str) -> float:
    start, end = before.orientation(name), after.orientation(name)
    low, high = pi / 3, 5 * pi / 3
    return end - start + 2 * pi * ((start > high and end < low) - (start < low and end > high))


REWARDS = {
    "displacement": displacement,
    "drop": drop,
    "staged_drop": staged_drop,
    "motion": lambda before, after, name, axis: abs(displacement(before, after, name, axis)),
    "away_from_start": away_from_start,
    "distance": distance,
    "gap": gap,
    "grown": lambda before, after, name, axis: after.extent(name)[AXES[axis]] - before.extent(name)[AXES[axis]],
    "hull": lambda before, after, name: after.hull(name) - before.hull(name),
    "turned": turned,
}

# ------------------------------------------------------------------------------------ terminations: of the state after


def beyond(now: Moment, name: str, axis: str, limit: float) -> bool:
    return now.com(name)[AXES[axis]] > limit


def short(now: Moment, name: str, axis: str, limit: float) -> bool:
    return now.com(name)[AXES[axis]] < limit


def tilted(now: Moment, name: str, low: float, high: float) -> bool:
    return low < now.orientation(name) < high


def fallen_or_tilted(now: Moment, name: str, limit: float, low: float, high: float) -> bool:
    return short(now, name, "y", limit) or tilted(now, name, low, high)


TERMINATIONS = {"beyond": beyond, "short": short, "tilted": tilted, "fallen_or_tilted": fallen_or_tilted}
