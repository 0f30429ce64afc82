"""Worlds in one line of code, and masks of fixed points."""

import numpy as np
import torch

from warpvox.design import sample_design
from warpvox.simulation import Simulation
from warpvox.world import World


def world(width: int, height: int, **objects: tuple) -> World:
    """Create a world from objects by name: cells, lower left corner, and optional connections."""
    made = World(width, height)
    for name, (cells, *place) in objects.items():
        made.add_from_array(name, np.asarray(cells), *place)
    return made


def crowded_world(seed: int) -> World:
    """Create a random robot between boxes on bumpy ground."""
    bumps = np.full((2, 24), 5)
    bumps[0, ::3] = 0
    places = enumerate([(1, 2), (8, 2), (2, 8), (5, 8)])
    boxes = {f"box{n}": (np.full((1 + n % 2, 2), 1 + n % 2), *place) for n, place in places}
    robot = sample_design((5, 5), seed=seed), 3, 2
    return world(24, 16, ground=(bumps, 0, 0), **boxes, bridge=([[5, 2, 2, 5]], 14, 4), robot=robot)


def fixed_rows(sim: Simulation) -> torch.Tensor:
    """Return a mask of fixed points among the positions in ``sim.state()``, bool ``[num_envs, rows]``."""
    pack, lane = sim.slot // sim.buffers.lanes, sim.slot % sim.buffers.lanes
    rows, real = sim.rows
    free = sim.array("free_lanes")[sim.array("pack_mesh").long()[pack][:, None], rows // 2]
    return ((free >> lane[:, None]) & 1 == 0) & real


def ground(width: int, rows: int = 1) -> tuple[np.ndarray, int, int]:
    return np.full((rows, width), 5), 0, 0
