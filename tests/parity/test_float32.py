"""float32 is as close to float64 as float64 is to itself with its actions rounded to float32."""

import numpy as np
import pytest
import torch

from warpvox.design import sample_design
from warpvox.simulation import Simulation
from warpvox.types import VOXEL, Cell
from warpvox.world import World

ROUNDED = 1e-7  # half-width of the noise on actions: what rounding them to float32 does
STEPS, FAR, BODIES = 10, 90, 8


def simulate(dtype: str, column: int, noise: float) -> torch.Tensor:
    """Points of random bodies on flat ground under sine waves, after STEPS control steps."""
    worlds = []
    for seed in range(BODIES):
        world = World()
        world.add_from_array("ground", np.full((1, 2 * FAR), int(Cell.FIXED)), 0, 0)
        world.add_from_array("robot", sample_design((5, 5), seed=seed), column, 1)
        worlds.append(world)
    sim = Simulation(worlds, device="cpu", dtype=dtype, threads=1)
    rng = np.random.default_rng(0)
    shape = (BODIES, sim.num_actions)
    rate, phase = rng.uniform(0.01, 0.1, shape), rng.uniform(0.0, 1.0, shape)
    for step in range(STEPS):
        # whole multiples of 1 / 1024 are exact in both
        actions = np.rint(1024 * (1.1 + 0.5 * np.sin(2 * np.pi * (rate * step + phase)))) / 1024
        sim.step(torch.as_tensor(actions + noise * rng.uniform(-1.0, 1.0, shape)))
    return sim.state()["pos"]


@pytest.mark.parametrize("column", [1, FAR])
def test_float32_adds_no_more_than_rounded_actions_do(column: int) -> None:
    """Near the origin and at x = 9 alike: springs are computed on displacements, not positions."""
    exact, noisy, single = (
        simulate(*how) for how in (("float64", column, 0.0), ("float64", column, ROUNDED), ("float32", column, 0.0))
    )
    apart, bound = ((one - exact).abs().amax(1).median() for one in (single, noisy))
    assert 0 < apart < 4 * bound < 1e-6 * VOXEL
