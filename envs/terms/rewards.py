"""Reward terms: functions of the states before and after a control step that give float64 ``[num_envs]``.

Under an unstable step both states are equal, so that every term gives 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

    from warpvox.envs.state import State

__all__ = ["AXES", "displacement", "drop"]

AXES = {"x": 0, "y": 1}


def displacement(before: State, after: State, name: str, axis: str) -> Tensor:
    """How far the centre of mass has moved along an axis: the paper's delta p."""
    column = AXES[axis]
    return after.com(name)[:, column] - before.com(name)[:, column]


def drop(before: State, after: State, name: str, below: float) -> Tensor:
    """How far the centre of mass has risen (negative: fallen) where it is now below a height, else 0."""
    height = after.com(name)[:, 1]
    return (height - before.com(name)[:, 1]).masked_fill(height >= below, 0.0)
