"""Operations on arrays of bodies, int8 ``[n, rows, columns]``: mutation, neighbours, counting."""

import numpy as np

from warpvox.design import are_valid
from warpvox.types import ROBOT_CELLS

CELL_TYPES = len(ROBOT_CELLS)
"""Number of cell types of a robot."""


def body_key(body: np.ndarray) -> bytes:
    """Return bytes that identify a body among bodies of the same shape."""
    return np.ascontiguousarray(body, dtype=np.int8).tobytes()


def mutate(rng: np.random.Generator, bodies: np.ndarray, rate: float | np.ndarray) -> np.ndarray:
    """Copy bodies and change the type of each voxel with probability ``rate`` (a number or ``[n, 1, 1]``)."""
    changes = rng.random(bodies.shape) < rate
    # Adding 1 to 4 modulo 5 gives every other type with equal probability, and never the same type.
    steps = rng.integers(1, CELL_TYPES, bodies.shape, dtype=np.int8)
    return np.where(changes, (bodies + steps) % CELL_TYPES, bodies).astype(np.int8)


def neighbours(bodies: np.ndarray) -> np.ndarray:
    """List all bodies that differ in one voxel: int8 ``[n, cells * 4, rows, columns]``."""
    n, rows, columns = bodies.shape
    cells = rows * columns
    near = np.repeat(bodies.reshape(n, 1, cells), cells * (CELL_TYPES - 1), axis=1)
    place = np.arange(cells * (CELL_TYPES - 1), dtype=np.int64)
    near[:, place, place % cells] = (near[:, place, place % cells] + 1 + place // cells) % CELL_TYPES
    return near.reshape(n, -1, rows, columns)


def count_valid(shape: tuple[int, int]) -> int:
    """Count the valid bodies of a small ``shape`` by enumeration (5 to the power of the cells)."""
    cells = shape[0] * shape[1]
    codes = np.arange(CELL_TYPES**cells, dtype=np.int64)[:, None] // CELL_TYPES ** np.arange(cells) % CELL_TYPES
    return int(are_valid(codes.reshape(-1, *shape)).sum())
