"""The broad phase's candidates are exactly the pairs that brute force finds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from warpvox.kernels.broadphase import (
    GRID_FROM,
    boxes,
    collect_near,
    collect_pairs,
    list_pairs,
    mark_all,
    mark_grid,
)
from warpvox.kernels.launch import launch_stage
from warpvox.packs import MARGIN
from warpvox.sim import Simulation
from warpvox.world import World

LANES = 8


def make(rows=18, columns=18, lanes=LANES):
    """One ring-shaped body with more surface voxels than the grid needs, over a strip of ground."""
    world = World(60, 40)
    world.add_from_array("ground", np.full((1, 60), 5), 0, 0)
    ring = np.full((rows, columns), 3)
    ring[2:-2, 2:-2] = 0
    world.add_from_array("robot", ring, 10, 5)
    return Simulation([world] * lanes, device="cpu", dtype="float64", lanes=lanes)


@pytest.fixture(scope="module")
def sim():
    return make()


def scatter(sim, seed, spread):
    """Throw every point of every lane somewhere near its place; the bounds that follow, [lanes, voxels, 4]."""
    state, rng = sim._state, np.random.default_rng(seed)
    home = state.arrays["home"].numpy()[0]
    pos = home[None] + rng.normal(scale=spread, size=state.arrays["pos"].shape)
    state.arrays["pos"].assign(pos)
    launch_stage(boxes, state)
    corners = state.arrays["corner"].numpy()[0]
    x, y = pos[0, 0::2][corners], pos[0, 1::2][corners]  # [voxels, 4, lanes]
    return np.stack([x.min(1), x.max(1), y.min(1), y.max(1)], -1).transpose(1, 0, 2)


def brute_force(sim, bounds):
    """Pairs i < j whose boxes, together MARGIN wider, overlap or touch in some lane."""
    x0, x1, y0, y1 = np.moveaxis(bounds, -1, 0)
    meets = np.ones((len(bounds), bounds.shape[1], bounds.shape[1]), bool)
    for low, high in ((x0, x1), (y0, y1)):
        meets &= low[:, :, None] <= high[:, None, :] + MARGIN
        meets &= low[:, None, :] <= high[:, :, None] + MARGIN
    return {(i, j) for i, j in zip(*np.nonzero(meets.any(0)), strict=True) if i < j}


def candidates(sim, *stages):
    for build in (*stages, list_pairs):
        launch_stage(build, sim._state)
    count = int(sim._state.arrays["pair_count"].numpy()[0])
    pairs = sim._state.arrays["pairs"].numpy()[0, :count, :2]
    return [(int(i), int(j)) for i, j in pairs]


@given(seed=st.integers(0, 10**6), spread=st.sampled_from([0.0, 0.01, 0.05, 0.2]))
@settings(max_examples=25, deadline=None)
def test_grid_and_brute_force_agree(sim, seed, spread):
    """Or the overflow flag says that candidates were left out, for voxels torn over too many cells."""
    bounds = scatter(sim, seed, spread)
    assert bounds.shape[1] >= GRID_FROM
    expected = sorted(brute_force(sim, bounds))
    for build in (mark_grid, mark_all):
        sim._state.arrays["overflow"].zero_()
        found = candidates(sim, build)
        if sim._state.arrays["overflow"].numpy()[0]:
            assert spread > 0.1
            assert set(found) <= set(expected)
        else:
            assert found == expected


def test_too_many_candidates_set_the_overflow_flag():
    sim = make(lanes=1)  # lanes that share a list have room for all pairs
    state = sim._state
    state.arrays["pos"].assign(np.full(state.arrays["pos"].shape, 3.0))  # everything in one place
    sim.step(np.ones((1, sim.num_actions)))
    assert bool(sim.overflow.all())
    sim.reset()
    sim.step(np.ones((1, sim.num_actions)))
    assert not bool(sim.overflow.any())


def test_values_that_are_not_finite_are_no_candidates(sim):
    scatter(sim, 0, 0.01)
    pos = sim._state.arrays["pos"].numpy()
    pos[:, :, 3] = np.nan
    pos[:, :, 4] = np.inf
    sim._state.arrays["pos"].assign(pos)
    launch_stage(boxes, sim._state)
    clean = np.delete(np.arange(LANES), (3, 4))
    x = sim._state.arrays["box"].numpy()[0].reshape(-1, 4, LANES)[:, :, clean].transpose(2, 0, 1)
    assert candidates(sim, mark_grid) == sorted(brute_force(sim, x))


@pytest.fixture(scope="module")
def mixed():
    """A robot above a body of soft and fixed cells: some voxels stand still, some share points with them."""
    world = World(30, 12)
    world.add_from_array("robot", np.full((3, 4), 3), 8, 6)
    world.add_from_array("bridge", np.array([[5, 5, 2, 2, 2, 2, 5, 5, 5], [5, 0, 0, 2, 2, 0, 0, 0, 5]]), 5, 3)
    return Simulation([world] * LANES, device="cpu", dtype="float64", lanes=LANES)


@given(seed=st.integers(0, 10**6), spread=st.sampled_from([0.0, 0.01, 0.05, 0.2]))
@settings(max_examples=25, deadline=None)
def test_still_voxels_are_candidates_of_mobile_ones_only(mixed, seed, spread):
    sim = mixed
    state, rng = sim._state, np.random.default_rng(seed)
    home, free = state.arrays["home"].numpy()[0], np.repeat(state.arrays["free_lanes"].numpy()[0] != 0, 2)
    pos = home[None] + free[None, :, None] * rng.normal(scale=spread, size=state.arrays["pos"].shape)
    state.arrays["pos"].assign(pos)
    launch_stage(boxes, state)
    x, y = (pos[0, axis::2][state.arrays["corner"].numpy()[0]] for axis in (0, 1))
    bounds = np.stack([x.min(1), x.max(1), y.min(1), y.max(1)], -1).transpose(1, 0, 2)
    still = state.arrays["still"].numpy()[0]
    assert 4 < still.sum() < len(still)
    expected = sorted((i, j) for i, j in brute_force(sim, bounds) if not (still[i] and still[j]))
    launch_stage(collect_pairs, state)
    count = int(state.arrays["pair_count"].numpy()[0])
    assert [tuple(p) for p in state.arrays["pairs"].numpy()[0, :count, :2].tolist()] == expected


@given(seed=st.integers(0, 10**6), drop=st.floats(-0.2, 0.6))
@settings(max_examples=20, deadline=None)
def test_voxels_near_terrain_are_found(sim, seed, drop):
    bounds = scatter(sim, seed, 0.03)
    state = sim._state
    pos = state.arrays["pos"].numpy()
    pos[:, 1::2] -= 0.4 - drop
    state.arrays["pos"].assign(pos)
    launch_stage(boxes, state)
    launch_stage(collect_near, state)
    near = set(state.arrays["near"].numpy()[0, : int(state.arrays["near_count"].numpy()[0])].tolist())
    low, high = bounds[..., 2] - (0.4 - drop), bounds[..., 3] - (0.4 - drop)
    reaches = (low <= 0.1 + MARGIN) & (high >= -MARGIN)
    sure = (low <= 0.1 + MARGIN - 1e-3) & (high >= -MARGIN + 1e-3)
    assert set(np.flatnonzero(sure.any(0))) <= near
    slack = (low <= 0.1 + MARGIN + 1e-3) & (high >= -MARGIN - 1e-3)
    assert near <= set(np.flatnonzero((reaches | slack).any(0)))


def test_candidates_know_their_shared_corners():
    world = World(5, 5)
    world.add_from_array("robot", np.array([[3, 3], [3, 0]]), 1, 1)
    sim = Simulation([world], device="cpu", dtype="float64", lanes=1)
    launch_stage(boxes, sim._state)
    launch_stage(collect_pairs, sim._state)
    pairs = {tuple(p[:2]): (int(p[2]), int(p[3])) for p in sim._state.arrays["pairs"].numpy()[0]}
    # Corner bits: 1 top left, 2 top right, 4 bottom right, 8 bottom left.
    assert pairs[(0, 1)] == (1 | 8, 2 | 4)  # side by side: the outer corners are their own
    assert pairs[(0, 2)] == (1 | 2, 4 | 8)  # one above the other
    assert pairs[(1, 2)] == (1 | 2 | 4, 1 | 4 | 8)  # diagonal neighbours share one corner
