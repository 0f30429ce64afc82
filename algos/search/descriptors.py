"""Descriptors of bodies, numbers from 0 to 1: the axes along which MAP-Elites keeps designs apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpvox.types import Cell

__all__ = ["describe"]

SHARES = {
    "actuators": (Cell.H_ACT, Cell.V_ACT),
    "empty": (Cell.EMPTY,),
    "rigid": (Cell.RIGID,),
    "soft": (Cell.SOFT,),
    "horizontal": (Cell.H_ACT,),
    "vertical": (Cell.V_ACT,),
}
"""Shares of all cells of the grid."""


def describe(bodies: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """float64 ``[n, descriptors]`` of bodies ``[n, rows, columns]``.

    ``actuators``, ``empty``, ``rigid``, ``soft``, ``horizontal`` and ``vertical`` are shares of the grid's cells;
    ``height`` and ``width`` what the body spans of the grid; ``symmetry`` is the share of cells that equal their
    mirror image from left to right.
    """
    return np.stack([_describe(bodies, name) for name in names], 1)


def _describe(bodies: np.ndarray, name: str) -> np.ndarray:
    if name in SHARES:
        return np.isin(bodies, SHARES[name]).mean((1, 2))
    if name == "symmetry":
        return (bodies == bodies[:, :, ::-1]).mean((1, 2))
    # a body is in one piece, so that it touches every row and column between its ends
    touched = (bodies != Cell.EMPTY).any(axis={"height": 2, "width": 1}[name])
    return touched.mean(1)
