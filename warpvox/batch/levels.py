"""Schedule of rigid sides in the group layout: sides of one level are corrected in parallel."""

from collections.abc import Mapping

import numpy as np


def by_level(tables: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Sort the tables of rigid sides, ``rigid_spring`` and ``rigid_lanes``, by level.

    The last side s of a level is written as -1 - s.

    The level of a side is one more than the highest of an earlier side that shares a point with it. So sides of a level
    share no point and may be corrected at once, and of two that share one the earlier remains the earlier: the result
    is that of correcting them one after another, bit for bit.
    """
    sides = tables["rigid_spring"]  # [packs, sides], of which `rigids` are in use
    packs = np.arange(len(sides))
    ends = tables["spring_ends"][packs[:, None], sides]  # [packs, sides, 2]
    reached = np.zeros((len(sides), tables["rest_pos"].shape[1] // 2), int)  # the highest level at each point so far
    level = np.zeros(sides.shape, int)
    for n in range(sides.shape[1]):
        first, second = ends[:, n].T
        level[:, n] = 1 + np.maximum(reached[packs, first], reached[packs, second])
        reached[packs, first] = level[:, n]
        reached[packs, second] = level[:, n]

    # Sides in use first
    level[np.arange(sides.shape[1]) >= tables["rigids"][:, None]] = sides.shape[1] + 1
    order = np.argsort(level, axis=1, kind="stable")
    sides = np.take_along_axis(sides, order, axis=1)
    level = np.take_along_axis(level, order, axis=1)
    last = np.ones(sides.shape, bool)
    last[:, :-1] = level[:, 1:] != level[:, :-1]
    return {
        "rigid_spring": np.where(last, -1 - sides, sides),
        "rigid_lanes": np.take_along_axis(tables["rigid_lanes"], order, axis=1),
    }
