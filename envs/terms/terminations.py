"""Termination terms: functions of the state after a control step that return bool ``[num_envs]``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from warpvox.envs.about import about
from warpvox.envs.terms.arrays import library
from warpvox.types import AXES

if TYPE_CHECKING:
    from torch import Tensor

    from warpvox.envs.snapshot import Snapshot


@about("{axis}_{name} > {limit}")
def beyond(state: Snapshot, name: str, axis: str, limit: float) -> Tensor:
    """Return whether the centre of mass has passed ``limit`` along an axis."""
    return state.com(name)[:, AXES[axis]] > limit


@about("max {axis} of the points of {name} > {limit}")
def reaches(state: Snapshot, name: str, axis: str, limit: float) -> Tensor:
    """Return whether the foremost point of the object has passed ``limit`` along an axis."""
    column = AXES[axis]
    along = state.relative_positions(name)[:, column]
    return library(along).amax(along, 1) + state.com(name)[:, column] > limit


@about("{axis}_{name} < {limit}")
def short(state: Snapshot, name: str, axis: str, limit: float) -> Tensor:
    """Return whether the centre of mass is below ``limit`` along an axis."""
    return state.com(name)[:, AXES[axis]] < limit


@about("y_{name} < {limit} or {low!d} < θ_{name} < {high!d}")
def fallen_or_tilted(state: Snapshot, name: str, limit: float, low: float, high: float) -> Tensor:
    """Return whether the centre of mass is lower than ``limit`` or the object is :func:`tilted`."""
    return short(state, name, "y", limit) | tilted(state, name, low, high)


@about("{low!d} < θ_{name} < {high!d}")
def tilted(state: Snapshot, name: str, low: float, high: float) -> Tensor:
    """Return whether the orientation is in the open interval (low, high), radians in [0, 2 pi)."""
    angle = state.orientation(name)
    return (angle > low) & (angle < high)
