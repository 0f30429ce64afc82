"""Reward terms: functions of the states before and after a control step that return float64 ``[num_envs]``.

Under an unstable step both states are equal, so that every term gives 0.
"""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING

from warpvox.envs.about import about
from warpvox.envs.terms.arrays import double, library, replaced
from warpvox.types import AXES

if TYPE_CHECKING:
    from torch import Tensor

    from warpvox.envs.snapshot import Snapshot


@about("Δ{axis}_{name}")
def displacement(before: Snapshot, after: Snapshot, name: str, axis: str) -> Tensor:
    """Return the movement of the centre of mass along an axis (the paper's delta p)."""
    column = AXES[axis]
    return after.com(name)[:, column] - before.com(name)[:, column]


@about("[y_{name} < {below}] Δy_{name}")
def drop(before: Snapshot, after: Snapshot, name: str, below: float) -> Tensor:
    """Return the vertical movement of the centre of mass where it is now below a height, else 0."""
    height = after.com(name)[:, 1]
    return replaced(height - before.com(name)[:, 1], height >= below, 0.0)


@about("[y_{name} < ({below} if x_{name} <= {x} else {below_beyond})] Δy_{name}")
def staged_drop(before: Snapshot, after: Snapshot, name: str, below: float, x: float, below_beyond: float) -> Tensor:
    """Return :func:`drop`, with another height ``below_beyond`` where the centre of mass is beyond ``x``."""
    place = after.com(name)[:, 0]
    height = after.com(name)[:, 1]
    above = library(height).where(place <= x, height >= below, height >= below_beyond)
    return replaced(height - before.com(name)[:, 1], above, 0.0)


@about("|Δ{axis}_{name}|")
def motion(before: Snapshot, after: Snapshot, name: str, axis: str) -> Tensor:
    """Return the absolute movement of the centre of mass along an axis (|delta p|)."""
    return abs(displacement(before, after, name, axis))


@about("(Δx_{name} if x_{name} >= 0 else -Δx_{name})")
def away_from_start(before: Snapshot, after: Snapshot, name: str) -> Tensor:
    """Return the movement of the centre of mass away from x = 0, on the side where it is now."""
    moved = displacement(before, after, name, "x")
    return library(moved).where(after.com(name)[:, 0] >= 0, moved, -moved)


@about("Δ|{goal} - {axis}_{name}|")
def distance(before: Snapshot, after: Snapshot, name: str, axis: str, goal: float) -> Tensor:
    """Return the increase of the distance to a goal along an axis (delta |g - p|)."""
    column = AXES[axis]
    return abs(goal - after.com(name)[:, column]) - abs(goal - before.com(name)[:, column])


@about("Δ|{axis}_{name} - {axis}_{other}|")
def gap(before: Snapshot, after: Snapshot, name: str, other: str, axis: str) -> Tensor:
    """Return the increase of the distance between two objects along an axis (delta |p^name - p^other|)."""
    column = AXES[axis]
    now = abs((after.com(name) - after.com(other))[:, column])
    return now - abs((before.com(name) - before.com(other))[:, column])


@about("Δ(max {axis} - min {axis} of the points of {name})")
def grown(before: Snapshot, after: Snapshot, name: str, axis: str) -> Tensor:
    """Return the growth of the object along an axis (delta (max p_i - min p_i))."""
    column = AXES[axis]
    return after.extent(name)[:, column] - before.extent(name)[:, column]


@about("Δ(area of the convex hull of {name})")
def hull(before: Snapshot, after: Snapshot, name: str) -> Tensor:
    """Return the growth of the convex hull's area (delta a)."""
    return after.hull_area(name) - before.hull_area(name)


@about("Δθ_{name} (full turns counted)")
def turned(before: Snapshot, after: Snapshot, name: str) -> Tensor:
    """Return the counter-clockwise rotation of the object, continuous past a full turn (delta theta).

    As released: a step from below pi / 3 to above 5 pi / 3 has gone through 0 clockwise, and the other way round. A
    full turn counts 2 pi, although orientations are measured modulo 2 x 3.1415926.
    """
    start = before.orientation(name)
    end = after.orientation(name)
    low = pi / 3
    high = 5 * pi / 3
    forward = double((start > high) & (end < low))
    backward = double((start < low) & (end > high))
    return end - start + 2 * pi * (forward - backward)


@about("Σ (a_{name} - 1)²")
def control_cost(before: Snapshot, after: Snapshot, name: str) -> Tensor:
    """Return the sum of squared distances of the actions from rest, as a cost of energy; use a negative weight."""
    return _squares(after.actions(name) - 1.0)


@about("Σ (Δa_{name})²")
def action_rate(before: Snapshot, after: Snapshot, name: str) -> Tensor:
    """Return the sum of squared changes of the actions since the last step; a negative weight gives smooth motion."""
    return _squares(after.actions(name) - before.actions(name))


def _squares(values: Tensor) -> Tensor:
    """Return the sum of squares of each row, added left to right so that torch and numpy agree."""
    return (double(values) ** 2).cumsum(1)[:, -1]
