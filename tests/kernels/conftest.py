"""What the tests of single stages share: a crowded scene in random states, and plain arrays of it."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from warpvox.design import sample_design
from warpvox.simulation import Simulation
from warpvox.world import World

CASES = {"float64": (8, 1e-9), "float32": (8, 2e-5)}
"""Lanes (those of other tests, whose kernels these tests share) and tolerance, relative to the largest number."""


def crowded_world(seed):
    """A robot between boxes on a bumpy ground."""
    ground = np.full((2, 24), 5)
    ground[0, ::3] = 0
    world = World(24, 16)
    world.add_from_array("ground", ground, 0, 0)
    for n, (x, y) in enumerate([(1, 2), (8, 2), (2, 8), (5, 8)]):
        world.add_from_array(f"box{n}", np.full((1 + n % 2, 2), 1 + n % 2), x, y)
    world.add_from_array("bridge", np.array([[5, 2, 2, 5]]), 14, 4)
    world.add_from_array("robot", sample_design((5, 5), seed=seed), 3, 2)
    return world


class Scene:
    """Copies of a crowded world, one a lane; ``close`` compares with an oracle."""

    def __init__(self, dtype, physics="evogym"):
        lanes, self.tolerance = CASES[dtype]
        options = dict(device="cpu", dtype=dtype, arithmetic="fast", lanes=lanes, threads=1, physics=physics)
        self.sim = Simulation([crowded_world(1)] * lanes, **options)
        self.lanes, self.design = range(lanes), self.sim.designs[0]
        arrays = self.sim._state.arrays
        self.model = SimpleNamespace(**{n: a.numpy()[0] for n, a in arrays.items() if a.shape[0] == 1 and a.ndim < 4})
        self.law = self.sim._state.model
        self.springs, self.points = int(self.model.springs), int(self.model.points)
        self.active = self.model.active[: 2 * int(self.model.actives) : 2] // 2
        self.free = self.model.free_lanes[: self.points] != 0
        self.order = self.model.order[: self.points, 0]  # of points in states and observations

    def scatter(self, seed, squeeze=0.8, noise=0.02, speed=3.0, drop=0.0):
        """Random positions and velocities of what can move."""
        rng, state = np.random.default_rng(seed), self.sim.state()
        moving = torch.as_tensor(np.repeat(self.free[self.order], 2))
        self.sim.reset()
        home = self.sim.state()["pos"]
        pos = home * squeeze + torch.as_tensor(rng.normal(0, noise, home.shape))
        pos[:, 1::2] -= drop
        for name, value in (("pos", torch.where(moving, pos[:, : 2 * self.points], home[:, : 2 * self.points])),):
            state[name][:, : 2 * self.points] = value
        for name in ("vel", "true_vel"):
            state[name] = torch.as_tensor(rng.normal(0, speed, home.shape)) * (state["pos"] != home)
        self.sim.set_state(state)
        return rng

    def read(self, name, width=2):
        """``[lanes, rows, width]`` of an array of the pack, ``[lanes, rows]`` for width 1."""
        rows = self.sim._state.arrays[name].numpy()[0].T.astype(np.float64)
        return rows if width == 1 else rows.reshape(len(rows), -1, width)

    def write(self, name, values):
        array = self.sim._state.arrays[name]
        whole = array.numpy()
        flat = values.reshape(len(values), -1).T
        whole[0, : len(flat)] = flat
        array.assign(whole)

    def close(self, found, expected):
        np.testing.assert_allclose(found, expected, rtol=0, atol=self.tolerance * np.abs(expected).max())


@pytest.fixture(name="crowded_world", scope="session")
def fixture_of_crowded_world():
    """``crowded_world(seed)``: a world with the robot of that seed."""
    return crowded_world


@pytest.fixture(scope="session")
def scenes():
    """``scenes(dtype, physics)``: each made once."""
    made = {}

    def scene(dtype, physics="evogym"):
        if (dtype, physics) not in made:
            made[dtype, physics] = Scene(dtype, physics)
        return made[dtype, physics]

    return scene
