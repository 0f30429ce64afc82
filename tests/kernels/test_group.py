"""The group layout, on the CPU in Warp's cooperative blocks, against the lanes: the same bits."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import warp as wp
from worlds import crowded_world, ground, world

from warpvox.batch import arrays, options
from warpvox.envs.registry import task_ids
from warpvox.envs.vec_env import make_vec
from warpvox.errors import SimulationError
from warpvox.kernels import group
from warpvox.kernels.device import record, zeros
from warpvox.simulation import Simulation

ROUNDING = 5e-9
"""Of positions after a control step, approximate against exact: springs round in float32 in both. The same batches in
float64 differ from float32 by 2e-9 (docs/performance.md)."""


def pair_of(worlds, dtype="float32", **options):
    """The same batch in lanes, one a pack, and in groups."""
    options = dict(device="cpu", dtype=dtype, arithmetic="fast", threads=1) | options
    return Simulation(worlds, lanes=1, **options), Simulation(worlds, layout="group", **options)


def pair_of_task(task, count=2, **options):
    sim = make_vec(task, num_envs=1, device="cpu", dtype="float32", lanes=1, threads=1).sim
    return pair_of([sim.worlds[0]] * count, loose=sim.loose, physics=sim.physics, **options)


def random_actions(sim, seed):
    generator = torch.Generator().manual_seed(seed)
    return 0.6 + torch.rand((sim.num_envs, sim.num_actions), generator=generator)


def differences(lanes, groups):
    mine, other = lanes.state(), groups.state()
    return [name for name in mine if not torch.equal(mine[name], other[name])]


def run(sims, steps, seed=0):
    for step in range(steps):
        actions = random_actions(sims[0], 100 * seed + step)
        for sim in sims:
            sim.step(actions)
        assert not differences(*sims), step


@pytest.mark.parametrize("task", task_ids())
def test_every_task_takes_the_same_way_in_both_layouts(task):
    sims = pair_of_task(task)
    assert [sim.layout for sim in sims] == ["lanes", "group"]
    run(sims, 4)
    for sim in sims:
        sim.reset(torch.tensor([True, False]))
    assert sims[1].time.tolist() == [0, 4]
    run(sims, 4, seed=1)


def take_parts(sim, parts):
    state = sim._state
    state.group = replace(state.group, parts=parts)
    state.scratch = zeros((state.packs, state.group.row), wp.float64, "cpu")
    return state


@pytest.mark.slow
@pytest.mark.parametrize("parts", [16, 32, 64, 128])
@pytest.mark.parametrize("task", ["Walker-v0", "BridgeWalker-v0", "Climber-v1", "Traverser-v0"])
def test_double_precision_and_other_groups(task, parts):
    for dtype in ("float32", "float64"):
        sims = pair_of_task(task, dtype=dtype)
        take_parts(sims[1], parts)
        run(sims, 12)


@pytest.mark.parametrize("task", ["Walker-v0", "BeamToppler-v0", "BridgeWalker-v0", "Climber-v1"])
def test_what_is_approximate_on_cuda_stays_within_rounding(task):
    lanes, groups = pair_of_task(task)
    groups._state.group = replace(groups._state.group, approximate=True)
    farthest = 0.0
    for step in range(8):
        groups.set_state(lanes.state())
        for sim in (lanes, groups):
            sim.step(random_actions(lanes, step))
        farthest = max(farthest, float((lanes.state()["pos"] - groups.state()["pos"]).abs().max()))
    assert 0.0 < farthest < ROUNDING


@pytest.mark.parametrize("order", [5, 15])
def test_threads_may_run_in_any_order(order):
    """A race between two barriers would show: on the CPU the threads of a group run one after another."""
    sims = pair_of_task("Traverser-v0", count=1)
    state, steps = sims[1]._state, sims[1].physics.substeps
    sims[1].step(torch.ones(1, sims[1].num_actions))
    sims[0].step(torch.ones(1, sims[0].num_actions))
    sims[1]._launches = [group.record_group(state, steps, 0, 1, order)]
    run(sims, 6)


@pytest.mark.slow
def test_all_corners_are_tested_where_there_are_more_candidates_than_codes(monkeypatch):
    monkeypatch.setattr(group, "CODED", 2)
    group.group_kernel.cache_clear()
    try:
        run(pair_of(crowd(3)), 12)
    finally:
        group.group_kernel.cache_clear()


@pytest.mark.slow
def test_groups_of_a_warp_go_the_same_way():
    """The groups of a warp are one block that votes and waits together, as on CUDA: different bodies."""
    sims = pair_of(crowd(8))
    state = take_parts(sims[1], 16)
    inputs = [state.model, state.data, state.scratch, 0, 8, 0, sims[1].physics.substeps, state.dt]
    kernel = group.group_kernel(state.group, whole_warps=True)
    sims[1]._launches = [record(kernel, (8, 16), inputs, "cpu", group.WARP, together=True)]
    run(sims, 24)


def crowd(count):
    """Different robots."""
    return [crowded_world(seed) for seed in range(count)]


def disturb(sims, change):
    state = sims[0].state()
    change(state, sims[0])
    for sim in sims:
        sim.set_state({name: value.clone() for name, value in state.items()})


def test_frozen_folded_and_diverged_environments_leave_the_others_alone():
    sims = pair_of(crowd(6))
    run(sims, 3)

    def change(state, sim):
        rows = sim.rows_of("robot")
        state["pos"][1, 4] = float("nan")
        tear = torch.tensor([9.0e3, -9.0e3]).repeat(int(rows[2].sum()))[: int(rows[2].sum())]
        state["vel"][2, rows[2]] = tear.double()  # within the bounds, not for long
        robot = state["pos"][3, rows[3]].view(-1, 2)
        middle = robot[:, 0].mean()
        state["pos"][3, rows[3]] = torch.stack([middle + (robot[:, 0] - middle).abs(), robot[:, 1]], 1).flatten()
        state["frozen"][4] = 1

    disturb(sims, change)
    actions = random_actions(sims[0], 7)
    before = sims[1].state()
    for sim in sims:
        sim.step(actions)
    lanes, groups = sims
    assert torch.equal(groups.unstable, lanes.unstable)
    assert torch.equal(groups.diverged, lanes.diverged)
    assert groups.unstable.tolist() == [False, True, True, True, False, False]
    assert groups.diverged[1]
    assert not groups.diverged[3]
    assert groups.time.tolist() == [4, 3, 3, 3, 3, 4]
    assert not {"pos", "vel", "true_vel", "time", "frozen"} & set(differences(*sims))
    for name in ("pos", "vel"):  # undone
        assert torch.equal(groups.state()[name][2:5], before[name][2:5])
    for sim in sims:
        sim.set_frozen(torch.zeros(6, dtype=torch.bool))
        sim.reset(torch.tensor([False, True, True, True, False, False]))
    run(sims, 3, seed=2)


def test_bits_do_not_depend_on_the_batch():
    worlds = crowd(3)
    together, alone = pair_of(worlds)[1], [pair_of([one])[1] for one in worlds]
    for step in range(5):
        actions = random_actions(together, step)
        together.step(actions)
        for k, sim in enumerate(alone):
            sim.step(actions[k : k + 1, : sim.num_actions])
    for k, sim in enumerate(alone):
        count = sim.state()["pos"].shape[1]
        for name in ("pos", "vel", "true_vel"):
            assert torch.equal(together.state()[name][k : k + 1, :count], sim.state()[name])


def test_worlds_are_exchanged_in_the_running_batch():
    worlds = crowd(4)
    sims = pair_of(worlds[:3], grid=(5, 5))
    run(sims, 2)
    mask = torch.tensor([False, True, False])
    for sim in sims:
        sim.set_worlds([worlds[3]], mask)
    run(sims, 3, seed=1)
    fresh = pair_of([worlds[0], worlds[3], worlds[2]], grid=(5, 5))[1]
    for step in range(3):
        fresh.step(random_actions(fresh, 100 + step))
    for name in ("pos", "vel", "true_vel"):
        assert torch.equal(fresh.state()[name][1], sims[1].state()[name][1])


def test_the_layout_is_chosen_by_device_arithmetic_and_size(monkeypatch):
    walker = pair_of_task("Walker-v0", count=1)[0]
    assert walker.layout == "lanes"
    resolved = options.resolve_layout
    assert resolved(None, "fast", "cpu", None) == "lanes"
    assert resolved(None, "fast", "cuda:0", None) == "group"
    assert resolved(None, "fast", "cuda:0", 32) == "lanes"
    assert resolved(None, "exact", "cuda:0", None) == "lanes"
    monkeypatch.setattr(arrays, "choose", lambda *sizes: None)
    assert pair_of_task("Walker-v0", count=1)[1].layout == "lanes"  # too large for a group


def chosen(points, springs, rigids, precision="float32", device="cuda:0", **room):
    sizes = dict(point=points, mover=points, spring=springs, rigid=rigids)
    return group.choose(sizes, precision, device, **room)


def test_all_tasks_fit_into_shared_memory():
    for precision in ("float32", "float64"):
        assert chosen(36, 104, 150, precision).parts == 16
        assert chosen(48, 133, 32, precision).parts == 16
        assert chosen(72, 133, 88, precision).parts == 32
    for points, springs, rigids, parts in [(356, 560, 40, 64), (370, 362, 8, 64), (344, 850, 628, 128)]:
        assert chosen(points, springs, rigids).parts == parts  # the largest worlds of the tasks
    assert chosen(36 * 36, 5000, 1220, device="cpu").points >= 36 * 36
    assert chosen(61 * 61, 14000, 1220, device="cpu") is None


@pytest.mark.parametrize(
    ("kilobytes", "parts"),
    [(227, [256, 512, None]), (163, [256, None, None]), (99, [32, None, None]), (48, [None, None, None])],
)
def test_large_bodies_take_the_shared_memory_that_the_device_has(kilobytes, parts):
    """H200, A100, RTX 40, and what there is without asking; in float64 that is all."""
    bodies = [(26 * 26, 2550, 580), (36 * 36, 4970, 1220), (41 * 41, 6480, 1600)]  # 25, 35 and 40 voxels a side
    room = dict(room=kilobytes * 1024)
    groups = [chosen(*sizes, **room) for sizes in bodies]
    assert [None if one is None else one.parts for one in groups] == parts
    assert all(chosen(*sizes, "float64", **room) is None for sizes in bodies)


def test_the_simulation_asks_the_device_for_its_shared_memory(monkeypatch):
    asked = []
    monkeypatch.setattr(arrays, "shared_memory", lambda device: 4711)
    monkeypatch.setattr(arrays, "choose", lambda *options: asked.append(options[-1]))
    assert pair_of_task("Walker-v0", count=1)[1].layout == "lanes"
    assert asked == [4711]


@pytest.mark.slow
@pytest.mark.parametrize("side", [15, 25, 35])
def test_full_bodies_in_the_memory_of_cuda(side):
    cells = np.random.default_rng(side).choice(np.array([1, 2, 3, 4], np.int8), (side, side))
    sim = make_vec("Walker-v0", [cells], num_envs=1, device="cpu", dtype="float32", lanes=1, threads=1).sim
    sims = pair_of([sim.worlds[0]], loose=sim.loose, physics=sim.physics)
    take_memory_of_cuda(sims[1])
    assert sims[1]._state.group.parts == {15: 128, 25: 256, 35: 512}[side]
    for step in range(6):
        sims[1]._state.scratch.fill_(float("nan"))
        run(sims, 1, seed=step)


def test_a_layout_that_there_is_not_is_refused():
    exact = dict(layout="group", arithmetic="exact", dtype="float64")
    for asked in (dict(layout="groups"), exact, dict(layout="group", lanes=8)):
        with pytest.raises(SimulationError):
            Simulation(crowd(1), device="cpu", **asked)


def take_memory_of_cuda(sim):
    on_cuda = group.choose(sim._state.sizes, "float32", "cuda:0", 227 * 1024)
    sim._state.group = replace(on_cuda, approximate=False)
    take_parts(sim, on_cuda.parts)


LARGER = [pytest.param(task, marks=pytest.mark.slow) for task in ("Catcher-v0", "Climber-v1", "Traverser-v0")]


@pytest.mark.parametrize("task", ["Walker-v0", *LARGER])
def test_memory_as_cuda_has_it(task):
    """The capacities of CUDA, where what is used in turn overlaps most closely; nothing is zero at first."""
    sims = pair_of_task(task)
    take_memory_of_cuda(sims[1])
    for step in range(8):
        sims[1]._state.scratch.fill_(float("nan"))
        run(sims, 1, seed=step)


def test_a_fixed_object_that_lies_on_terrain_touches_nothing():
    """Its points are behind those that have contacts."""
    blocks = {"ground": (np.full((2, 24), 5), 0, 0), "peg": (np.full((2, 2), 5), 12, 4)}
    blocks |= {"ball": (np.full((2, 2), 2), 16, 3), "robot": (np.array([[3, 3, 3], [4, 1, 4], [3, 0, 3]]), 3, 2)}
    sims = pair_of([world(24, 16, **blocks)] * 2, loose=("peg",))
    take_memory_of_cuda(sims[1])
    for sim in sims:
        sim.shift(torch.tensor([[0, -2], [-8, -3]]))  # on the ground, under the robot
    run(sims, 20)
    assert not sims[1].unstable.any()


def test_bodies_with_cut_connections_are_left_to_lanes():
    """Lanes have twins where the other end of a cut is connected: two points that move as one; a group has none."""
    slit = world(10, 10, ground=ground(10), robot=([[3, 3], [3, 3]], 2, 1, [[0, 1, 2], [2, 3, 3]]))
    whole = world(10, 10, ground=ground(10), robot=([[3, 3], [3, 3]], 2, 1))
    assert pair_of([whole])[1].layout == "group"
    for sims in (pair_of([slit]), pair_of([whole, slit], grid=(2, 2))):
        assert sims[1].layout == "lanes"
        run(sims, 3)


@pytest.mark.slow  # in a kernel of its own: there must be no room beyond the points that move
def test_points_that_never_move_have_no_contacts():
    """Corners of a fixed cell lie in a wall; on CUDA there is memory for the points that move alone."""
    blocks = {"ground": ground(20), "wall": (np.full((3, 1), 5), 11, 1), "shelf": ([[2, 2, 2, 2, 2, 5]], 5, 3)}
    sims = pair_of([world(20, 10, **blocks, robot=([[3]], 2, 1))])
    take_memory_of_cuda(sims[1])
    assert sims[1]._state.group.movers < sims[1]._state.sizes["point"]
    run(sims, 4)
    assert not sims[1].unstable.any()
