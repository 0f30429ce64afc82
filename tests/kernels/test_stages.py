"""The stages, launched one by one, do what the fused control step does, bit for bit."""

import numpy as np
import pytest
import torch
from stages import launch_stage, launch_stages
from worlds import ground, world

from warpvox.design import sample_design
from warpvox.kernels.reset import save, settle
from warpvox.kernels.springs import goals
from warpvox.simulation import STATE_FIELDS, Simulation
from warpvox.types import Physics

STEPS = 6


def make(dtype, arithmetic, lanes):
    box, bodies = (np.full((2, 2), 1), 8, 1), [sample_design((5, 5), seed=seed) for seed in range(3)]
    worlds = [world(30, 10, ground=ground(30), box=box, robot=(body, 1, 1)) for body in bodies]
    return Simulation(worlds * lanes, device="cpu", dtype=dtype, arithmetic=arithmetic, lanes=lanes)


def step_by_stages(state):
    launch_stage(save, state)
    launch_stage(goals, state)
    for _ in range(Physics().substeps):
        launch_stages(state)
    launch_stage(settle, state)


@pytest.mark.parametrize(
    ("dtype", "arithmetic", "lanes"),
    [("float64", "exact", 8), pytest.param("float64", "fast", 8, marks=pytest.mark.slow), ("float32", "fast", 8)],
)
def test_stages_make_up_the_control_step(dtype, arithmetic, lanes):
    fused, staged = make(dtype, arithmetic, lanes), make(dtype, arithmetic, lanes)
    rng = np.random.default_rng(0)
    for _ in range(STEPS):
        actions = torch.tensor(rng.uniform(0.6, 1.6, (fused.num_envs, fused.num_actions)))
        fused.step(actions)
        staged._state.arrays["action"].assign(fused._state.arrays["action"])
        step_by_stages(staged._state)
    expected, found = fused.state(), staged.state()
    for name in STATE_FIELDS:
        assert torch.equal(expected[name], found[name]), name


@pytest.mark.slow
def test_goals_of_more_actuators_than_15_bits_count():
    side = 182
    many = world(side, side, robot=(np.full((side, side), 3), 0, 0))
    sim = Simulation([many], device="cpu", dtype="float64", lanes=1)
    assert 2**15 < sim.num_actions == side**2
    actions = torch.full((1, side**2), 0.6, dtype=torch.float64)
    actions[0, -1] = 1.6  # its upper side is also that of the voxel above, which has another number
    sim.take(actions)
    sim.place_actions()
    launch_stage(goals, sim._state)
    springs = int(sim.array("springs")[0])
    lengths = sim.array("goal")[0, :springs, 0] / sim.array("spring_rest")[0, :springs]
    driven = lengths[lengths != 1]
    assert driven.unique().tolist() == pytest.approx([0.6, 1.1, 1.6])
    assert [(driven == value).sum() for value in driven.unique()] == [side * (side + 1) - 2, 1, 1]
