"""Worlds in a line."""

import numpy as np

from warpvox.world import World


def world(width: int, height: int, **objects: tuple) -> World:
    """A world of objects by name: cells, where their lower left corner is, and connections if not all."""
    made = World(width, height)
    for name, (cells, *place) in objects.items():
        made.add_from_array(name, np.asarray(cells), *place)
    return made


def ground(width: int, rows: int = 1) -> tuple[np.ndarray, int, int]:
    """Fixed cells at the bottom."""
    return np.full((rows, width), 5), 0, 0
