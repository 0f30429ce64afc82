"""Extent, hull and orientation of objects, and objects put elsewhere, against plain numpy."""

import numpy as np
import pytest
import torch
from worlds import ground, world

from warpvox.design import sample_design
from warpvox.errors import SimulationError
from warpvox.simulation import Simulation

EXACT = 1e-13  # sums in another order


def world_of(body, *, box=(12, 3)):
    peg = [[5, 5]], box[0], box[1] - 2
    return world(30, 12, ground=ground(30), box=([[2, 2], [2, 2]], *box), peg=peg, robot=(body, 1, 1))


def make(worlds, **options):
    return Simulation(worlds, **({"device": "cpu", "dtype": "float64"} | options))


def scatter(sim, points):
    """Put the robots' points at ``points`` [env, point, 2]."""
    state = sim.state()
    for e in range(sim.num_envs):
        flat = torch.as_tensor(points[e]).flatten()
        state["pos"][e, : len(flat)] = flat
    sim.set_state(state)


def area_by_all_pairs(points):
    """Every edge of the hull has all points on its left: sum over those edges."""
    total = 0.0
    for i, a in enumerate(points):
        for j, b in enumerate(points):
            rest = np.delete(points, [i, j], axis=0) - a
            if i != j and ((b - a)[0] * rest[:, 1] - (b - a)[1] * rest[:, 0] > 0).all():
                total += 0.5 * (a[0] * b[1] - a[1] * b[0])
    return total


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_hull_and_extent_of_random_points(dtype):
    body = sample_design((3, 3), seed=2)
    sim = make([world_of(body)] * 20, dtype=dtype)
    count = sim.num_points("robot")
    points = np.random.default_rng(1).normal(size=(20, count, 2))
    scatter(sim, points)
    areas, extents = sim.hull_area("robot"), sim.extent("robot")
    assert areas.dtype == extents.dtype == torch.float64
    np.testing.assert_allclose(areas.numpy(), [area_by_all_pairs(p) for p in points], rtol=0, atol=EXACT)
    np.testing.assert_allclose(extents.numpy(), np.ptp(points, axis=1), rtol=0, atol=EXACT)


def test_hull_of_points_in_line_twice_and_on_a_lattice():
    sim = make([world_of(np.full((3, 3), 3))] * 3)
    lattice = sim.object_positions("robot")[0].numpy()
    line = np.outer(np.linspace(0, 1, 16), [0.3, 0.1])
    twice = np.repeat([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0], [0.0, 2.0]], 4, axis=0)
    scatter(sim, np.stack([lattice, line, twice]))
    np.testing.assert_allclose(sim.hull_area("robot").numpy(), [0.09, 0.0, 2.0], rtol=0, atol=EXACT)


def test_orientation_is_the_angle_of_a_turn():
    sim = make([world_of(sample_design((4, 4), seed=1))] * 6)
    turns = np.array([0.3, 1.0, 2.0, 4.0, 5.0, 6.0])
    home = sim.object_positions("robot")[0].numpy()
    turned = [(home - home.mean(0)) @ np.array([[np.cos(t), np.sin(t)], [-np.sin(t), np.cos(t)]]) for t in turns]
    scatter(sim, np.stack(turned))
    np.testing.assert_allclose(sim.orientation("robot").numpy(), turns, rtol=0, atol=1e-6)  # as released, pi ends early


@pytest.mark.parametrize("lanes", [1, 8])
def test_shifted_objects_are_bit_for_bit_where_a_world_would_have_put_them(lanes):
    bodies = [sample_design((3, 3), seed=1), sample_design((5, 5), seed=2)]
    sim = make([world_of(bodies[e // 3]) for e in range(6)], loose=("box", "peg"), lanes=lanes)
    cells = torch.tensor([[0, 0], [3, 2], [-2, 1], [7, 0], [1, 5], [-4, 2]])
    sim.shift(cells)
    for e, (dx, dy) in enumerate(cells.tolist()):
        fresh = make([world_of(bodies[e // 3], box=(12 + dx, 3 + dy))])
        for name in ("box", "peg", "robot"):
            count = fresh.num_points(name)
            assert torch.equal(sim.object_positions(name)[e, :count], fresh.object_positions(name)[0])


def test_a_shift_touches_what_its_mask_names_and_a_reset_takes_it_back():
    sim = make([world_of(sample_design((3, 3), seed=1))] * 3, loose=("box", "peg"))
    home = sim.object_positions("box")
    sim.shift(torch.full((3, 2), 2), torch.tensor([False, True, False]))
    moved = sim.object_positions("box")
    assert torch.equal(moved[[0, 2]], home[[0, 2]])
    np.testing.assert_allclose((moved - home)[1].numpy(), 0.2, rtol=0, atol=EXACT)
    sim.reset()
    assert torch.equal(sim.object_positions("box"), home)


def test_loose_terrain_stays_in_place_and_carries():
    sim = make([world_of(sample_design((3, 3), seed=1))] * 2, loose=("peg",))
    sim.shift(torch.tensor([[0, 0], [-9, 5]]))  # the second peg is not below the box any more
    peg = sim.object_positions("peg")
    for _ in range(150):
        sim.step(torch.ones(2, sim.num_actions))
    assert torch.equal(sim.object_positions("peg"), peg)
    heights = sim.com("box")[:, 1]
    assert float(heights[0]) == pytest.approx(0.3, abs=0.02)
    assert float(heights[1]) == pytest.approx(0.2, abs=0.02)


def test_bad_shifts_are_refused():
    body = sample_design((3, 3), seed=1)
    with pytest.raises(SimulationError):
        make([world_of(body)], arithmetic="fast", loose=("robot",))
    with pytest.raises(SimulationError):
        make([world_of(body)], loose=("crate",))
    sim = make([world_of(body)] * 2, loose=("box",))
    with pytest.raises(SimulationError):
        sim.shift(torch.zeros((1, 2), dtype=torch.long))
    with pytest.raises(SimulationError):
        sim.shift(torch.zeros((2, 2)))
