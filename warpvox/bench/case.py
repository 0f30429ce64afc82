"""A case of a benchmark: what is simulated, as data; and the bodies of cases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from warpvox.algos.training.bodies import load_bodies
from warpvox.design import sample_design
from warpvox.errors import ConfigError, DesignError
from warpvox.types import Cell

__all__ = ["Case", "full_body", "one_body", "sampled_bodies", "sampled_or_full"]


@dataclass(frozen=True)
class Case:
    """Environments of one task that are timed together.

    Attributes:
        name: of its row in the tables.
        task: its id.
        bodies: int8 ``[rows, columns]`` each, in equal blocks of the environments.
        num_envs: environments stepped together.
        options: of ``make_vec``, where they differ from the configuration's.
    """

    name: str
    task: str
    bodies: Sequence[np.ndarray]
    num_envs: int
    options: dict[str, Any] = field(default_factory=dict)


def one_body(config: Any) -> np.ndarray:
    """The body that ``design`` names.

    Raises:
        ConfigError: it names several.
    """
    bodies = load_bodies(config.design, config.seed)
    if len(bodies) > 1:
        raise ConfigError(f"bench measures one body at a time, got {len(bodies)}.")
    return bodies[0]


def sampled_bodies(side: int, count: int, seed: int) -> list[np.ndarray]:
    """``count`` bodies int8 ``[side, side]`` by EvoGym's sampling rule."""
    return [sample_design((side, side), np.random.default_rng([seed, side, k])) for k in range(count)]


def full_body(side: int, seed: int) -> np.ndarray:
    """int8 ``[side, side]`` without an empty cell, the other kinds drawn alike; actuators at both upper corners."""
    cells = (Cell.RIGID, Cell.SOFT, Cell.H_ACT, Cell.V_ACT)
    body = np.random.default_rng([seed, side]).choice(np.array(cells, np.int8), (side, side))
    body[0, 0], body[0, -1] = Cell.H_ACT, Cell.V_ACT
    return body


def sampled_or_full(side: int, count: int, seed: int) -> tuple[list[np.ndarray], bool]:
    """``count`` bodies int8 ``[side, side]``, and whether they are sampled.

    Independent voxels of a large grid are hardly ever connected: then all bodies are full.
    """
    try:
        return sampled_bodies(side, count, seed), True
    except DesignError:
        return [full_body(side, seed + k) for k in range(count)], False
