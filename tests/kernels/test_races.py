"""No thread of a block reads or writes what another has written since the last barrier (``tests/helpers/races.py``)."""

import pytest
import torch
from races import races
from worlds import crowded_world

from warpvox.envs.vec_env import make_vec
from warpvox.simulation import Simulation

pytestmark = pytest.mark.slow
ENVS = 8


TASKS = ["Walker-v0", "BeamToppler-v0", "BridgeWalker-v0", "Catcher-v0", "Climber-v1", "Traverser-v0"]


@pytest.fixture(params=["crowd", *TASKS])
def sim(request):
    """Environments of a task, or different bodies on top of each other; one of them is frozen."""
    if request.param == "crowd":
        worlds, options = [crowded_world(seed) for seed in range(ENVS)], {}
    else:
        env = make_vec(request.param, num_envs=1, device="cpu", dtype="float32", lanes=1, threads=1)
        worlds, options = [env.sim.worlds[0]] * ENVS, dict(physics=env.sim.physics, loose=env.sim.loose)
    options = dict(device="cpu", dtype="float32", arithmetic="fast", threads=1, layout="group") | options
    sim = Simulation(worlds, **options)
    sim.set_frozen(torch.arange(ENVS) == 5)
    return sim


def test_what_another_thread_writes_is_read_behind_a_barrier(sim, tmp_path):
    found, watched = races(sim, 4, tmp_path)
    assert not found
    assert watched > 1e6


@pytest.mark.parametrize("parts", [16, 64, 128, 512])
def test_groups_of_different_bodies_too(parts, tmp_path):
    worlds = [crowded_world(seed) for seed in range(ENVS)]
    sim = Simulation(worlds, device="cpu", dtype="float32", arithmetic="fast", threads=1, layout="group")
    assert not races(sim, 4, tmp_path, parts)[0]


def test_a_barrier_that_is_missing_is_found(tmp_path):
    """The barrier between the forces of springs and their sums at the points."""
    sim = Simulation(
        [crowded_world(0)] * ENVS, device="cpu", dtype="float32", arithmetic="fast", threads=1, layout="group"
    )

    def without(text):
        barrier = "        sync();\n        Pair force[POINT_ROUNDS];"
        assert text.count(barrier) == 1
        return text.replace(barrier, "        Pair force[POINT_ROUNDS];")

    found, _ = races(sim, 1, tmp_path, change=without)
    assert any("tension" in conflict and conflict.startswith("write, read") for conflict in found)
