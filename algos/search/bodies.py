"""Many bodies at once: validity, sampling, mutation, neighbours. Arrays are int8 ``[n, rows, columns]``."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from warpvox.design import SAMPLING_WEIGHTS
from warpvox.types import Cell

__all__ = ["CELL_TYPES", "body_key", "count_valid", "first_valid", "mutate", "neighbours", "random_bodies", "valid"]

CELL_TYPES = len(SAMPLING_WEIGHTS)
"""A robot's voxel is one of these many types; they count from 0."""

MAX_VOXELS = 2_000_000
"""Voxels drawn in search of one body before its source counts as dry, unless said otherwise."""


def body_key(body: np.ndarray) -> bytes:
    """What tells a body from all others of its shape; as good as its hash, without collisions."""
    return np.ascontiguousarray(body, dtype=np.int8).tobytes()


def valid(bodies: np.ndarray) -> np.ndarray:
    """bool ``[n]``: connected along edges and with an actuator, as :func:`warpvox.design.check_design` has it."""
    if not len(bodies):
        return np.zeros(0, bool)
    solid = bodies != Cell.EMPTY
    # Flood fill of all bodies at once, from the first solid cell of each.
    flat = solid.reshape(len(bodies), -1)
    reached = np.zeros_like(flat)
    reached[np.arange(len(bodies)), flat.argmax(1)] = True
    reached = reached.reshape(solid.shape) & solid
    while True:
        grown = reached.copy()
        grown[:, 1:] |= reached[:, :-1]
        grown[:, :-1] |= reached[:, 1:]
        grown[:, :, 1:] |= reached[:, :, :-1]
        grown[:, :, :-1] |= reached[:, :, 1:]
        grown &= solid
        if np.array_equal(grown, reached):
            break
        reached = grown
    whole = (reached == solid).all((1, 2))
    return whole & np.isin(bodies, (Cell.H_ACT, Cell.V_ACT)).any((1, 2))


def random_bodies(rng: np.random.Generator, count: int, shape: tuple[int, int]) -> np.ndarray:
    """``count`` bodies, valid or not, by EvoGym's rule: independent voxels, empty three times as likely as others."""
    cumulative = np.cumsum(SAMPLING_WEIGHTS) / sum(SAMPLING_WEIGHTS)
    draws = np.searchsorted(cumulative[:-1], rng.random((count, *shape)), side="right")
    return draws.astype(np.int8)


def mutate(rng: np.random.Generator, bodies: np.ndarray, rate: float | np.ndarray) -> np.ndarray:
    """Copies in which each voxel has, with probability ``rate`` (also ``[n, 1, 1]``), turned into another type."""
    changes = rng.random(bodies.shape) < rate
    # adding 1..4 modulo 5 reaches every other type alike and never the same
    steps = rng.integers(1, CELL_TYPES, bodies.shape, dtype=np.int8)
    return np.where(changes, (bodies + steps) % CELL_TYPES, bodies).astype(np.int8)


def neighbours(bodies: np.ndarray) -> np.ndarray:
    """All bodies that differ in one voxel: int8 ``[n, cells * 4, rows, columns]``."""
    n, rows, columns = bodies.shape
    cells = rows * columns
    near = np.repeat(bodies.reshape(n, 1, cells), cells * (CELL_TYPES - 1), axis=1)
    place = np.arange(cells * (CELL_TYPES - 1))
    near[:, place, place % cells] = (near[:, place, place % cells] + 1 + place // cells) % CELL_TYPES
    return near.reshape(n, -1, rows, columns)


def first_valid(
    draw: Callable[[], np.ndarray], refuse: Callable[[bytes], bool], limit: int = MAX_VOXELS
) -> np.ndarray | None:
    """The first valid body of ``draw() -> [n, rows, columns]`` that is not refused; None after ``limit`` voxels."""
    drawn = 0
    while drawn < limit:
        bodies = draw()
        drawn += bodies.size
        for index in np.flatnonzero(valid(bodies)):
            if not refuse(body_key(bodies[index])):
                return bodies[index]
    return None


def count_valid(shape: tuple[int, int]) -> int:
    """How many valid bodies of a small ``shape`` there are, by trying all (5 to the power of the cells)."""
    cells = shape[0] * shape[1]
    codes = np.arange(CELL_TYPES**cells)[:, None] // CELL_TYPES ** np.arange(cells) % CELL_TYPES
    return int(valid(codes.reshape(-1, *shape)).sum())
