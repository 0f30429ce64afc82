"""Bodies and environments that the suites measure."""

from typing import Any

import numpy as np

from warpvox.algos.training.bodies import load_bodies
from warpvox.design import sample_design
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.errors import ConfigError, DesignError
from warpvox.types import Cell


def one_body(config: Any) -> Any:
    """The body that ``design`` names; ConfigError: it names several."""
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


def make(config: Any, bodies: Any, num_envs: int, task: str | None = None, **options: Any) -> VoxelVecEnv:
    """Environments as the configuration describes them; ``task`` and ``options`` of ``make_vec`` go before it."""
    common = {name: getattr(config, name) for name in ("device", "dtype", "arithmetic", "threads")}
    return make_vec(task or config.task, bodies, num_envs, **(common | options))
