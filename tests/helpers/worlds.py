"""Worlds in a line, and their fixed points."""

import numpy as np
import torch

from warpvox.design import sample_design
from warpvox.simulation import Simulation
from warpvox.world import World


def world(width: int, height: int, **objects: tuple) -> World:
    """A world of objects by name: cells, where their lower left corner is, and connections if not all."""
    made = World(width, height)
    for name, (cells, *place) in objects.items():
        made.add_from_array(name, np.asarray(cells), *place)
    return made


def crowded_world(seed: int) -> World:
    """A robot, of this seed, between boxes on a bumpy ground."""
    bumps = np.full((2, 24), 5)
    bumps[0, ::3] = 0
    places = enumerate([(1, 2), (8, 2), (2, 8), (5, 8)])
    boxes = {f"box{n}": (np.full((1 + n % 2, 2), 1 + n % 2), *place) for n, place in places}
    robot = sample_design((5, 5), seed=seed), 3, 2
    return world(24, 16, ground=(bumps, 0, 0), **boxes, bridge=([[5, 2, 2, 5]], 14, 4), robot=robot)


def fixed_rows(sim: Simulation) -> torch.Tensor:
    """bool [num_envs, rows]: which entries of the positions in ``sim.state()`` belong to points that never move."""
    pack, lane = sim.slot // sim.buffers.lanes, sim.slot % sim.buffers.lanes
    rows, real = sim.rows
    free = sim.array("free_lanes")[sim.array("pack_mesh").long()[pack][:, None], rows // 2]
    return ((free >> lane[:, None]) & 1 == 0) & real


def ground(width: int, rows: int = 1) -> tuple[np.ndarray, int, int]:
    """Fixed cells at the bottom."""
    return np.full((rows, width), 5), 0, 0
