"""Short lives: environments that are made, used and dropped, one for every body."""

import gc
import subprocess
import sys
import threading
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch

import warpvox as wv
import warpvox.envs  # the ids of gymnasium
from warpvox.compile import compile_world, world_arrays
from warpvox.types import Physics
from warpvox.world import World, WorldObject

ROOT = Path(__file__).parents[2]
MOST_OBJECTS = 300
"""Python objects that a hundred lives may leave behind: far less than one environment has."""
MOST_BYTES = 8 << 20
"""Memory that 900 lives may add: allocators keep some; what leaked 10 kB a life would add 9 MB."""


def live(task, seed):
    body = wv.sample_design((5, 5), seed=seed)
    env = gymnasium.make(f"warpvox/{task}", body=body)
    env.reset(seed=seed)
    obs, *_ = env.step(env.action_space.high)
    env.close()
    return obs


def objects():
    gc.collect()
    return len(gc.get_objects())


@pytest.mark.parametrize("task", ["Walker-v0", "Carrier-v0"])
def test_lives_leave_nothing_behind(task):
    for seed in range(10):
        live(task, seed)
    before = objects()
    for seed in range(10, 60):
        live(task, seed)
    assert objects() < before + MOST_OBJECTS


THOUSAND_LIVES = """
import gc, os, gymnasium, warpvox as wv, warpvox.envs
tasks = ("Walker-v0", "UpStepper-v0", "Carrier-v0", "BridgeWalker-v0")
for seed in range(1000):
    env = gymnasium.make("warpvox/" + tasks[seed % 4], body=wv.sample_design((5, 5), seed=seed))
    env.reset(seed=seed)
    env.step(env.action_space.high)
    env.close()
    if seed in (99, 999):
        gc.collect()
        print(int(open("/proc/self/statm").read().split()[1]) * os.sysconf("SC_PAGE_SIZE"))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_is_flat_over_a_thousand_lives():
    """In a process of its own: pytest keeps the warnings of each."""
    command = [sys.executable, "-W", "ignore", "-c", THOUSAND_LIVES]
    printed = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout.splitlines()
    before, after = (int(line) for line in printed if line.isdigit())
    assert after < before + MOST_BYTES


def test_the_next_environment_of_a_terrain_is_the_first_ones_equal():
    alone = live("UpStepper-v0", 3)
    for task in ("Climber-v0", "Carrier-v0", "UpStepper-v0"):
        live(task, 4)
    assert np.array_equal(live("UpStepper-v0", 3), alone)


def test_threads_that_make_environments_share_nothing_that_changes():
    expected = {seed: live("UpStepper-v0", seed) for seed in range(6)}
    found = {}

    def work(seed):
        found[seed] = live("UpStepper-v0", seed)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in expected]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(np.array_equal(found[seed], obs) for seed, obs in expected.items())


def test_equal_objects_differ_by_place_and_physics():
    """Tables of an object are kept by all that they depend on."""

    def arrays(x, physics, loose=()):
        world = World(30, 12)
        world.add_from_array("box", np.full((2, 3), 2), x, 4)
        world.add_object(WorldObject.from_array("floor", np.full((1, 30), 5)))
        return world_arrays(compile_world(world, Physics.preset(physics), loose))

    first = arrays(3, "evogym")
    moved = arrays(4, "evogym")
    stiffer = arrays(3, "paper")
    loose = arrays(3, "evogym", ("floor",))
    assert not np.array_equal(first["rest_pos"], moved["rest_pos"])
    assert not np.array_equal(first["spring_k"], stiffer["spring_k"])
    assert loose["points"] > first["points"]
    again = arrays(3, "evogym")
    assert all(np.array_equal(first[name], again[name]) for name in first)


def test_what_one_simulation_writes_no_other_sees():
    box = World(12, 8)
    box.add_from_array("box", np.full((2, 2), 1), 2, 3)
    first = wv.Simulation([box], device="cpu", dtype="float64")
    start = first.array("rest_pos").clone()
    first.array("rest_pos").add_(1.0)
    first.array("spring_k").zero_()
    second = wv.Simulation([box], device="cpu", dtype="float64")
    assert torch.equal(second.array("rest_pos"), start)
    assert bool((second.array("spring_k") > 0).all())


def test_an_array_outlives_its_simulation():
    box = World(12, 8)
    box.add_from_array("box", np.full((2, 2), 1), 2, 3)
    kept = [wv.Simulation([box], device="cpu", dtype="float64").array("pos") for _ in range(20)]
    gc.collect()
    expected = wv.Simulation([box], device="cpu", dtype="float64").array("pos")
    assert all(torch.equal(one, expected) for one in kept)
