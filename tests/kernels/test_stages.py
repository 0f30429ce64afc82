"""The stages, launched one by one, do what the fused control step does, bit for bit."""

import numpy as np
import pytest
import torch

from warpvox.design import sample_design
from warpvox.kernels import actuation, broadphase, contact, folding, integrate, reset, strain
from warpvox.sim import STATE_FIELDS, Simulation
from warpvox.types import SUBSTEPS
from warpvox.world import World

STEPS = 6


def make(dtype, lanes):
    worlds = []
    for seed in range(3):
        world = World(30, 10)
        world.add_from_array("ground", np.full((1, 30), 5), 0, 0)
        world.add_from_array("box", np.full((2, 2), 1), 8, 1)
        world.add_from_array("robot", sample_design((5, 5), seed=seed), 1, 1)
        worlds.append(world)
    return Simulation(worlds * lanes, device="cpu", dtype=dtype, lanes=lanes)


def step_by_stages(state):
    reset.launch_save(state)
    for _ in range(SUBSTEPS):
        broadphase.launch(state)
        contact.launch(state)
        actuation.launch(state)
        integrate.launch(state)
        strain.launch(state)
        integrate.launch_advance(state)
        folding.launch(state)
    reset.launch_settle(state)


@pytest.mark.parametrize(("dtype", "lanes"), [("float64", 1), ("float32", 32)])
def test_stages_make_up_the_control_step(dtype, lanes):
    fused, staged = make(dtype, lanes), make(dtype, lanes)
    rng = np.random.default_rng(0)
    for _ in range(STEPS):
        actions = torch.tensor(rng.uniform(0.6, 1.6, (fused.num_envs, fused.num_actions)))
        fused.step(actions)
        staged._state.arrays["action"].assign(fused._state.arrays["action"])
        step_by_stages(staged._state)
    expected, found = fused.state(), staged.state()
    for name in STATE_FIELDS:
        assert torch.equal(expected[name], found[name]), name
