"""The bodies of a suite."""

from __future__ import annotations

from typing import Any

import numpy as np

from warpvox.cli.build import load_bodies
from warpvox.design import sample_design
from warpvox.errors import ConfigError, DesignError
from warpvox.types import Cell

__all__ = ["full_body", "one_body", "sampled_or_full"]


def one_body(config: Any) -> np.ndarray:
    """The body that ``design`` names.

    Raises:
        ConfigError: it names several.
    """
    bodies = load_bodies(config.design, config.seed)
    if len(bodies) > 1:
        raise ConfigError(f"bench measures one body at a time, got {len(bodies)}.")
    return bodies[0]


def full_body(side: int, seed: int) -> np.ndarray:
    """int8 ``[side, side]`` without an empty cell, the other kinds drawn alike; actuators at both upper corners."""
    cells = (Cell.RIGID, Cell.SOFT, Cell.H_ACT, Cell.V_ACT)
    body = np.random.default_rng([seed, side]).choice(np.array(cells, np.int8), (side, side))
    body[0, 0], body[0, -1] = Cell.H_ACT, Cell.V_ACT
    return body


def sampled_or_full(side: int, count: int, seed: int) -> tuple[list[np.ndarray], bool]:
    """``count`` bodies int8 ``[side, side]``, and whether they are sampled.

    By EvoGym's sampling rule where it makes them; independent voxels of a large grid hardly ever hang together, and
    then all bodies are full.
    """
    try:
        return [sample_design((side, side), np.random.default_rng([seed, side, k])) for k in range(count)], True
    except DesignError:
        return [full_body(side, seed + k) for k in range(count)], False
