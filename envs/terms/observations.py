"""Observation terms (paper section B.1): functions of a state that return ``[num_envs, k]``.

A term that has a value for every point of an object gives ``[num_envs, 2, points]``; the environment drops
the padding of designs with fewer points.
"""

from __future__ import annotations

from math import inf, pi
from typing import TYPE_CHECKING

from warpvox.envs.about import ANGLE, LENGTH, NUMBER, SPEED, About, about
from warpvox.envs.terms.arrays import double, extremes_at, filled, library, long, replaced
from warpvox.envs.terms.goals import LONGEST, goal_x
from warpvox.types import SIGHT, VOXEL

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor

    from warpvox.envs.episodes import Episodes
    from warpvox.envs.snapshot import Snapshot

_SCAN_RANGE = SIGHT * VOXEL  # how far robots see up and down, in simulator units


def _count(reach: int, **_: object) -> int:
    """Return the number of windows of a terrain scan."""
    return 2 * reach + 1


@about("v_{name}", unit=SPEED, entries=2)
def velocity(state: Snapshot, name: str) -> Tensor:
    """Return the velocity of the centre of mass (v)."""
    return state.velocity(name)


@about("θ_{name}", unit=ANGLE, low=0.0, high=2 * pi)
def orientation(state: Snapshot, name: str) -> Tensor:
    """Return the rotation since the episode began, counter-clockwise in [0, 2 pi) (theta)."""
    return state.orientation(name)[:, None]


@about("c_{name}: x then y of all points about p_{name}", unit=LENGTH, entries=0, per_point=2)
def shape(state: Snapshot, name: str) -> Tensor:
    """Return all points relative to the centre of mass, all x before all y (c)."""
    return state.relative_positions(name)


@about("p_{name} - p_{other}", unit=LENGTH, entries=2)
def separation(state: Snapshot, name: str, other: str) -> Tensor:
    """Return the vector from the centre of mass of ``other`` to that of ``name`` (p^name - p^other)."""
    return state.com(name) - state.com(other)


@about(
    "floor below {name}, voxels -{reach} to {reach} beside it", unit=LENGTH, entries=_count, low=0.0, high=_SCAN_RANGE
)
def floor(state: Snapshot, name: str, reach: int, objects: tuple[str, ...]) -> Tensor:
    """Return the distance to the terrain below in each of ``2 reach + 1`` windows, as released.

    Window i (-reach .. reach) spans half a voxel to both sides of i voxels from the centre of mass; the
    distance goes to the highest point below and is cut at 5 voxels, which also stands for "none".
    """
    return state.floor_scan(name, reach, objects)


@about(
    "ceiling above {name}, voxels -{reach} to {reach} beside it", unit=LENGTH, entries=_count, low=0.0, high=_SCAN_RANGE
)
def ceiling(state: Snapshot, name: str, reach: int, objects: tuple[str, ...]) -> Tensor:
    """Return the distance to the lowest terrain above in each of ``2 reach + 1`` windows, as released."""
    return state.ceiling_scan(name, reach, objects)


@about("h_b({reach}): y of the terrain below {name}", unit=LENGTH, entries=_count)
def elevation(state: Snapshot, name: str, reach: int, objects: tuple[str, ...]) -> Tensor:
    """Return the height of the terrain below in ``2 reach + 1`` windows, as in the paper (h_b in section B.1).

    Entry i (-reach .. reach) is the y of the highest terrain point that lies below the centre of mass p and
    in [p_x + i, p_x + i + 1] voxels, ends included, however far down it is. Reading of what the paper leaves
    open: heights are absolute and in simulator units, as positions are; where a window holds no such point, the
    height is that of the floor at y = 0, on which bodies that leave the terrain do land.
    """
    floor = filled(state.com(name), (len(state.com(name)), 1), 0.0)
    return _windows(state, name, reach, objects, floor, above=False)


@about("h_a({reach}): y of the terrain above {name}", unit=LENGTH, entries=_count)
def overhang(state: Snapshot, name: str, reach: int, objects: tuple[str, ...]) -> Tensor:
    """Return the height of the terrain above in ``2 reach + 1`` windows, as in the paper (h_a in section B.1).

    Entry i is the y of the lowest terrain point above the centre of mass p in [p_x + i, p_x + i + 1] voxels, however
    far up it is. Reading of what the paper leaves open: without such a point it is 5 voxels above p, the distance
    that the released code gives where it finds none.
    """
    return _windows(state, name, reach, objects, state.com(name)[:, 1:] + _SCAN_RANGE, above=True)


def _windows(state: Snapshot, name: str, reach: int, objects: tuple[str, ...], nothing: Tensor, above: bool) -> Tensor:
    """Return the lowest point above, or the highest below, in each window; ``nothing`` in empty windows."""
    centre = state.com(name)
    none = inf if above else -inf
    xp = library(centre)
    width = 2 * reach + 3  # one more window on each side collects the rest
    heights = filled(centre, (len(centre), width), none)
    for terrain in objects:
        points = double(state.positions(terrain))
        x = points[..., 0]
        y = points[..., 1]

        # Points on the other side do not count
        hidden = y <= centre[:, 1:] if above else y >= centre[:, 1:]
        seen = replaced(y, hidden, none)

        # The extreme of each window
        along = (x - centre[:, :1]) / VOXEL
        # A point on the border of two windows belongs to both.
        for window in (xp.floor(along), xp.ceil(along) - 1):
            slot = long(xp.clip(window + (reach + 1), 0, width - 1))
            extremes_at(heights, slot, seen, "amin" if above else "amax")
    heights = heights[:, 1:-1]
    return xp.where(heights == none, nothing, heights)


@about("({x}, {y}) - p_{name}", unit=LENGTH, entries=2)
def short_of(state: Snapshot, name: str, x: float, y: float) -> Tensor:
    """Return the vector from the centre of mass to the goal g = (x, y): (g_x - p_x, g_y - p_y)."""
    centre = state.com(name)
    # Filled on the device: copying a list there would wait for it.
    goal = library(centre).concatenate((filled(centre, (1,), x), filled(centre, (1,), y)))
    return goal - centre


@about("goals reached", unit=NUMBER, low=0.0, high=LONGEST)
def goal_number(state: Snapshot, name: str) -> Tensor:
    """Return the number of goals reached (the paper's integer c)."""
    return state.memory("goal")


@about("x of the goal", unit=LENGTH)
def goal_place(state: Snapshot, name: str) -> Tensor:
    """Return the x of the present goal (g_x)."""
    return goal_x(state)


@about("x of the goal - x_{name}", unit=LENGTH)
def goal_offset(state: Snapshot, name: str) -> Tensor:
    """Return the distance in x from the object to the present goal (g_x - p_x)."""
    return goal_x(state) - state.com(name)[:, :1]


NAME = "elapsed_steps"


class ElapsedSteps:
    """Observation term of the time: control steps since the episode began, ``[num_envs, 1]``.

    With it the end of an episode by the time limit can be foreseen (Pardo et al. 2018, "Time Limits in Reinforcement
    Learning", section 3).
    """

    __name__ = NAME
    about = About("control steps since the episode began", low=0.0)

    def __init__(self, episodes: Episodes) -> None:
        self._length = episodes.length  # one tensor for good, which a captured step may read

    def __call__(self, state: Snapshot) -> Tensor:
        """Return the control steps since the episode began, ``[num_envs, 1]``."""
        return self._length[:, None]


def is_timed(columns: Mapping[str, slice]) -> bool:
    """Return whether an observation made of the terms in ``columns`` includes the elapsed steps."""
    return NAME in columns
