"""Fast arithmetic in float64 is exact arithmetic to rounding: the guard that keeps the two from drifting apart."""

import numpy as np
import pytest
import torch
from refusals import refused
from worlds import ground, world

from warpvox.envs.registry import task_ids
from warpvox.envs.vec_env import VoxelVecEnv, make_vec
from warpvox.errors import SimulationError
from warpvox.simulation import Simulation
from warpvox.types import VOXEL
from warpvox.view.rollout import record
from warpvox.world import World

TOLERANCE = 1e-10  # in simulator units: rounding, amplified by the contacts of a control step
LANES, AHEAD, LOOKS, SEED = 8, 20, 3, 3
BODY = np.array([[3, 4, 3, 4, 3], [4, 1, 2, 2, 4], [3, 2, 3, 1, 3], [4, 0, 0, 0, 4], [3, 0, 0, 0, 1]], dtype=np.int8)


def make(task: str, arithmetic: str) -> VoxelVecEnv:
    options = dict(device="cpu", dtype="float64", seed=SEED, auto_reset=False, lanes=LANES, threads=1)
    return make_vec(task, [BODY], LANES, arithmetic=arithmetic, **options)


@pytest.mark.parametrize("arithmetic", ["fast", "exact"])
def test_a_robot_with_a_fixed_cell_moves_as_in_the_release(arithmetic: str) -> None:
    """``robot``: recorded from evogym 2.0.0."""
    worlds = [world(8, 8, ground=ground(8), robot=(body, 3, 1)) for body in ([[4, 5]], [[4, 2], [3, 3]])]
    sim = Simulation(worlds, device="cpu", dtype="float64", arithmetic=arithmetic)
    for _ in range(5):
        sim.step(np.full((2, sim.num_actions), 1.4))
    robot = [
        [3.6562446527568535, 4.0, 2.9904890498642875, 4.0, 5.0, 5.0],
        [2.7373049003879695, 2.0, 1.6889585293219949, 1.0, 2.0, 1.0],
    ]
    found = sim.object_positions("robot")[0, :6].T / VOXEL
    torch.testing.assert_close(found, torch.tensor(robot, dtype=torch.float64), rtol=0, atol=TOLERANCE)


@pytest.mark.parametrize("task", task_ids())
def test_a_control_step_is_the_same_in_both(task: str) -> None:
    """From the start, and from states in motion and contact that exact arithmetic has reached."""
    fast, exact = make(task, "fast"), make(task, "exact")
    exact.reset()
    fast.reset()
    rng, moved = np.random.default_rng(SEED), 0.0
    for look in range(LOOKS):
        fast.sim.set_state(exact.sim.state())
        before = exact.sim.state()["pos"]
        actions = torch.as_tensor(rng.uniform(0.6, 1.6, (LANES, exact.num_actions)))
        for env in (fast, exact):
            env.sim.step(actions)
        found, expected = fast.sim.state(), exact.sim.state()
        assert torch.equal(found["status"], expected["status"]), look
        assert (found["pos"] - expected["pos"]).abs().max() < TOLERANCE, look
        moved = max(moved, float((expected["pos"] - before).abs().max()))
        for _ in range(AHEAD):
            exact.sim.step(torch.as_tensor(rng.uniform(0.6, 1.6, (LANES, exact.num_actions))))
    assert moved > 1e-3


def test_they_are_two_arithmetics() -> None:
    fast, exact = make("Walker-v0", "fast"), make("Walker-v0", "exact")
    rng = np.random.default_rng(SEED)
    for _ in range(AHEAD):
        actions = torch.as_tensor(rng.uniform(0.6, 1.6, (LANES, exact.num_actions)))
        fast.sim.step(actions)
        exact.sim.step(actions)
    assert not torch.equal(fast.sim.state()["pos"], exact.sim.state()["pos"])


@pytest.mark.parametrize(
    ("dtype", "given", "expected"),
    [
        ("float32", None, "fast"),
        ("float32", "fast", "fast"),
        ("float64", None, "exact"),
        ("float64", "fast", "fast"),
        ("float64", "exact", "exact"),
    ],
)
def test_the_arithmetic_is_chosen_apart_from_the_precision(dtype: str, given: str | None, expected: str) -> None:
    env = make_vec("Walker-v0", dtype=dtype, arithmetic=given, device="cpu", auto_reset=False, lanes=LANES)
    assert env.sim.arithmetic == expected
    if given:
        assert record(env, "zero", 1).metadata["arithmetic"] == expected


def small_world() -> World:
    small = World(6, 6)
    small.add_from_array("robot", np.full((2, 2), 3), 1, 1)
    return small


@pytest.mark.parametrize(
    ("dtype", "arithmetic", "said"),
    [
        ("float32", "exact", "needs dtype='float64'"),
        ("float64", "fasst", "Did you mean 'fast'"),
        ("float64", 1, "must be one of fast, exact, None, got 1"),
    ],
)
def test_what_there_is_not_is_refused(dtype: str, arithmetic: object, said: str) -> None:
    with refused(SimulationError, said):
        Simulation([small_world()], device="cpu", dtype=dtype, arithmetic=arithmetic)
