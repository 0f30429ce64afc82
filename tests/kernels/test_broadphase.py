"""The broad phase's candidates are exactly the pairs that brute force finds."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from stages import launch_stage
from worlds import ground, world

from warpvox.kernels.broadphase import (
    GRID_FROM,
    boxes,
    collect_near,
    collect_pairs,
    hulls,
    list_pairs,
    mark_all,
    mark_grid,
)
from warpvox.kernels.state import DISTANT
from warpvox.simulation import Simulation

MARGIN = 0.04  # two fifths of a voxel

LANES = 8


def make(rows=18, columns=18, lanes=LANES):
    """One ring-shaped body with more surface voxels than the grid needs, over a strip of ground."""
    ring = np.full((rows, columns), 3)
    ring[2:-2, 2:-2] = 0
    made = world(60, 40, ground=ground(60), robot=(ring, 10, 5))
    return Simulation([made] * lanes, device="cpu", dtype="float64", lanes=lanes)


@pytest.fixture(scope="module")
def sim():
    return make()


def corners_of(sim):
    """Positions of the corners of all surface voxels, [lanes, voxels, 4, 2]."""
    arrays = sim._state.arrays
    points = arrays["pos"].numpy()[0].reshape(-1, 2, arrays["pos"].shape[2])
    return points[arrays["corner"].numpy()[0]].transpose(3, 0, 1, 2)


def scatter(sim, seed, spread):
    """Throw every free point of every lane somewhere near its place; the corners of voxels, as above."""
    state, rng = sim._state, np.random.default_rng(seed)
    home, free = state.arrays["rest_pos"].numpy()[0], np.repeat(state.arrays["free_lanes"].numpy()[0] != 0, 2)
    noise = rng.normal(scale=spread, size=state.arrays["pos"].shape)
    state.arrays["pos"].assign(home[None] + np.where(free[None, :, None], noise, 0.0))
    launch_stage(boxes, state)
    return corners_of(sim)


def brute_force(sim, corners):
    """Candidates i < j with the corners of each, as bits, that are near the other voxel and none of its own.

    Near is: in its bounds, MARGIN wider, in some lane. Pairs without such corners are candidates where they are voxels
    of one robot, more than one cell apart, with bounds that overlap when they are MARGIN wider: they may fold.
    """
    arrays = sim._state.arrays
    corner, body, robot, grid = (arrays[name].numpy()[0] for name in ("corner", "body", "robot", "grid"))
    low, high = corners.min(2), corners.max(2)  # [lanes, voxels, 2]
    inside = low[:, :, None, None] - MARGIN <= corners[:, None]
    inside &= corners[:, None] <= high[:, :, None, None] + MARGIN
    near = inside.all(-1).any(0)  # [voxel, other voxel, its corner]
    near &= ~(corner[:, None, None, :] == corner[None, :, :, None]).any(-1)
    bits = near @ (1 << np.arange(4))
    meets = (low[:, :, None] <= high[:, None] + MARGIN) & (low[:, None] <= high[:, :, None] + MARGIN)
    folds = meets.all(-1).any(0) & (robot[:, None] >= 0) & (body[:, None] == body)
    folds &= abs(grid[:, None] - grid).max(-1) > 1
    found = {}
    for i, j in zip(*np.nonzero(np.triu((bits > 0) | (bits > 0).T | folds, 1)), strict=True):
        far = abs(grid[i] - grid[j]).max() > 1 and robot[i] >= 0 and body[i] == body[j]
        found[int(i), int(j)] = int(bits[j, i]) | (int(DISTANT) if far else 0), int(bits[i, j])
    return found


def candidates(sim, *stages):
    for build in stages:
        launch_stage(build, sim._state)
    count = int(sim._state.arrays["pair_count"].numpy()[0])
    pairs = sim._state.arrays["pairs"].numpy()[0, :count].tolist()
    assert pairs == sorted(pairs)
    return {(i, j): (mine, other) for i, j, mine, other in pairs}


@given(seed=st.integers(0, 10**6), spread=st.sampled_from([0.0, 0.01, 0.05, 0.2]))
@settings(max_examples=25, deadline=None)
def test_grid_and_brute_force_agree(sim, seed, spread):
    """Or the overflow flag says that candidates were left out, for voxels torn over too many cells."""
    corners = scatter(sim, seed, spread)
    assert corners.shape[1] >= GRID_FROM
    expected = brute_force(sim, corners)
    for build in (mark_grid, mark_all):
        sim._state.arrays["overflow"].zero_()
        found = candidates(sim, hulls, build, list_pairs)
        if sim._state.arrays["overflow"].numpy()[0]:
            assert spread > 0.1
            assert found.items() <= expected.items()
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
    scatter(sim, 0, 0.03)
    pos = sim._state.arrays["pos"].numpy()
    pos[:, :, 3] = np.nan
    pos[:, :, 4] = np.inf
    sim._state.arrays["pos"].assign(pos)
    launch_stage(boxes, sim._state)
    clean = np.delete(np.arange(LANES), (3, 4))
    assert candidates(sim, mark_grid, list_pairs) == brute_force(sim, corners_of(sim)[clean])


@pytest.fixture(scope="module")
def mixed():
    """A robot above a body of soft and fixed cells: some voxels stand still, some share points with them."""
    bridge = [[5, 5, 2, 2, 2, 2, 5, 5, 5], [5, 0, 0, 2, 2, 0, 0, 0, 5]]
    made = world(30, 12, robot=(np.full((3, 4), 3), 8, 6), bridge=(bridge, 5, 3))
    return Simulation([made] * LANES, device="cpu", dtype="float64", lanes=LANES)


@given(seed=st.integers(0, 10**6), spread=st.sampled_from([0.0, 0.01, 0.05, 0.2]))
@settings(max_examples=25, deadline=None)
def test_still_voxels_are_candidates_of_mobile_ones_only(mixed, seed, spread):
    expected = brute_force(mixed, scatter(mixed, seed, spread))
    still = mixed._state.arrays["fixed_voxel"].numpy()[0]
    assert 4 < still.sum() < len(still)
    expected = {(i, j): bits for (i, j), bits in expected.items() if not (still[i] and still[j])}
    assert candidates(mixed, collect_pairs) == expected


@given(seed=st.integers(0, 10**6), drop=st.floats(-0.2, 0.6))
@settings(max_examples=20, deadline=None)
def test_voxels_near_terrain_are_found(sim, seed, drop):
    height = scatter(sim, seed, 0.03)[..., 1]
    state = sim._state
    pos = state.arrays["pos"].numpy()
    pos[:, 1::2] -= 0.4 - drop
    state.arrays["pos"].assign(pos)
    launch_stage(boxes, state)
    launch_stage(hulls, state)
    launch_stage(collect_near, state)
    near = set(state.arrays["near"].numpy()[0, : int(state.arrays["near_count"].numpy()[0])].tolist())
    low, high = height.min(-1) - (0.4 - drop), height.max(-1) - (0.4 - drop)
    reaches = (low <= 0.1 + MARGIN) & (high >= -MARGIN)
    sure = (low <= 0.1 + MARGIN - 1e-3) & (high >= -MARGIN + 1e-3)
    assert set(np.flatnonzero(sure.any(0))) <= near
    slack = (low <= 0.1 + MARGIN + 1e-3) & (high >= -MARGIN - 1e-3)
    assert near <= set(np.flatnonzero((reaches | slack).any(0)))
