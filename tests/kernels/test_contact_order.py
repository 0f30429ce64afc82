"""In float64 contacts are taken in the order of a descent through two box trees, here done the plain way."""

import itertools

import numpy as np
import pytest
import torch
from stages import launch_stages
from worlds import crowded_world

from warpvox.contact_order import order_arrays, tree_of
from warpvox.simulation import Simulation

SQUEEZE, NOISE = 0.7, 0.06


@pytest.fixture
def crowd():
    """``crowd(seed, lanes)``: contacts of a robot pressed together with its world, in copies; what was noted."""

    def contacts(seed, lanes):
        sim = Simulation([crowded_world(seed)] * lanes, device="cpu", dtype="float64", lanes=lanes)
        state, rng = sim.state(), np.random.default_rng(seed)
        state["pos"] = state["pos"] * SQUEEZE + torch.tensor(rng.normal(0.0, NOISE, state["pos"].shape))
        sim.set_state(state)
        launch_stages(sim._state, "boxes", "collect", "contacts")
        return sim, {name: sim._state.arrays[name].numpy()[0] for name in ("hits", "hit", "hit_rank", "pos", "node")}

    return contacts


class Descent:
    """Pairs of leaves whose boxes overlap, in the order in which the released simulator finds them."""

    def __init__(self, design, pos):
        self.node = order_arrays(design)["node"]
        self.box, self.roots = [], {}
        objects = [body.source for body in design.bodies + design.statics]
        names = [obj.name for obj in sorted(objects, key=lambda obj: (not obj.is_robot, obj.name))]
        for body in design.bodies + design.statics:
            points = np.array(body.points)
            if body in design.bodies:
                points = pos[body.first_point : body.first_point + len(points)]
            base, tree = len(self.box), tree_of(body)
            for cell, pair in zip(tree.cells, tree.children, strict=True):
                inner = [corner for child in pair or () for corner in self.box[base + child]]
                mine = np.array(inner) if pair else points[body.corners[cell]]
                self.box.append((mine.min(0), mine.max(0)))
            self.roots[body.name] = len(self.box) - 1
        self.roots = [self.roots[name] for name in names]

    def area(self, n):
        low, high = self.box[n]
        return (high[0] - low[0]) * (high[1] - low[1])

    def pairs(self):
        for a, b in itertools.combinations_with_replacement(self.roots, 2):
            yield from self.descend(a, b)

    def descend(self, a, b):
        (low_a, high_a), (low_b, high_b) = self.box[a], self.box[b]
        if (low_a > high_b).any() or (low_b > high_a).any():
            return
        leaf_a, leaf_b = self.node[a, 0] < 0, self.node[b, 0] < 0
        if leaf_a and leaf_b:
            yield a, b
        elif leaf_a or (not leaf_b and self.area(a) < self.area(b)):
            for child in self.node[b, :2]:
                yield from self.descend(a, int(child))
        else:
            for child in self.node[a, :2]:
                yield from self.descend(int(child), b)


@pytest.mark.parametrize("lanes", [pytest.param(1, marks=pytest.mark.slow), 8])
@pytest.mark.parametrize("seed", range(4))
def test_contacts_are_taken_in_the_order_of_the_descent(crowd, seed, lanes):
    sim, arrays = crowd(seed, lanes)
    assert not sim.overflow.any()
    for k, count in enumerate(arrays["hits"]):
        hits = arrays["hit"][:count, k]
        taken = [tuple(hits[rank, :3]) for rank in arrays["hit_rank"][:count, k]]
        met = Descent(sim.designs[0], arrays["pos"][:, k].reshape(-1, 2)).pairs()
        place = {pair: n for n, pair in enumerate(met)}
        assert len(set(taken)) == count > 20
        assert taken == sorted(taken, key=lambda hit, place=place: (place[hit[:2]], hit[2]))
