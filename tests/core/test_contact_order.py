"""The trees that say in which order contacts are met."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from worlds import ground, world

from warpvox import contact_order as order
from warpvox.compile import compile_world, mesh
from warpvox.contact_order import BUCKETS, HashSet, order_arrays, tree_of
from warpvox.design import full_connections, sample_design
from warpvox.errors import SimulationError
from warpvox.io.world_files import LARGEST_GRID
from warpvox.kernels.exact.order import PATH
from warpvox.types import Physics
from warpvox.world import WorldObject


class Chained:
    """The same set as the C++ library builds it: one linked list, and per bucket the node before its first."""

    def __init__(self):
        self.count, self.room, self.size = 1, 0, 0
        self.next = {"head": None}
        self.before = {}

    def numbers(self):
        out, node = [], self.next["head"]
        while node is not None:
            out.append(node)
            node = self.next[node]
        return out

    def link(self, number):
        bucket = number % self.count
        if bucket in self.before:
            self.next[number] = self.next[self.before[bucket]]
            self.next[self.before[bucket]] = number
        else:
            first = self.next["head"]
            self.next[number], self.next["head"] = first, number
            if first is not None:
                self.before[first % self.count] = number
            self.before[bucket] = "head"

    def add(self, number):
        old = self.numbers()
        if number in old:
            return
        if len(old) + 1 > self.room:
            self.count = self.room = next(n for n in BUCKETS[1:] if n >= max(11, 2 * self.room))
            self.next, self.before = {"head": None}, {}
            for other in old:
                self.link(other)
        self.link(number)

    def discard(self, number):
        keep = self.numbers()
        if number not in keep:
            return
        keep.remove(number)
        chain = ["head", *keep]
        self.next = dict(zip(chain, [*keep, None], strict=True))
        self.before = {}
        for before, node in zip(chain, keep, strict=False):
            self.before.setdefault(node % self.count, before)


@settings(max_examples=60)
@given(st.lists(st.tuples(st.booleans(), st.integers(0, 300)), max_size=150))
def test_the_set_is_gone_through_as_a_chained_hash_table(changes):
    ours, chained = HashSet(), Chained()
    for is_added, number in changes:
        for one in (ours, chained):
            one.add(number) if is_added else one.discard(number)
    assert list(ours) == chained.numbers()


def test_a_set_holds_the_cells_of_the_largest_world():
    numbers = HashSet()
    for number in range(21_000):
        numbers.add(number)
    assert sorted(numbers) == list(range(21_000))
    assert BUCKETS[-1] >= LARGEST_GRID


def compiled(seed, shape=(5, 5)):
    robot = sample_design(shape, seed=seed), 1, 1
    made = world(20, 12, ground=ground(20), box=(np.full((2, 2), 1), 12, 1), robot=robot)
    return compile_world(made, Physics.preset("evogym"))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([(3, 3), (5, 5), (4, 7)]))
def test_a_tree_holds_every_surface_voxel_once(seed, shape):
    design = compiled(seed, shape)
    for body in design.bodies + design.statics:
        tree = tree_of(body)
        begin, middle = tree.ranks()
        leaves = {cell: n for n, cell in enumerate(tree.cells) if cell is not None}
        assert set(leaves) == set(body.surface)
        assert len(tree.cells) == 2 * len(leaves) - 1
        assert sorted(begin[n] for n in leaves.values()) == list(range(len(leaves)))
        for n, pair in enumerate(tree.children):
            if pair:
                assert max(pair) < n
                parts = np.array([tree.boxes[child] for child in pair])
                assert tree.boxes[n] == (*parts[:, :2].min(0), *parts[:, 2:].max(0))
                assert (begin[pair[0]], begin[pair[1]]) == (begin[n], middle[n])


@pytest.mark.parametrize("seed", range(20))
def test_the_first_of_the_smallest_pairs_is_joined(seed):
    """Found among all pairs, which are listed again for each join; with holes and cells that are not connected."""
    rng = np.random.default_rng(seed)
    cells = rng.integers(1, 6, (6, 8)) * (rng.random((6, 8)) < rng.choice([0.3, 0.7, 0.9]))
    pairs = full_connections(cells)
    pairs = pairs[rng.random(len(pairs)) < rng.choice([0.5, 1.0])]
    body = mesh(WorldObject.from_array("object", cells, 3, 1, pairs.T), Physics.preset("evogym"))
    tree = tree_of(body)
    leaf = {cell: node for node, cell in enumerate(tree.cells) if cell}
    near, left = [order._neighbours(body, cell, leaf) for cell in leaf], list(range(len(leaf)))
    for merged in range(len(leaf), len(tree.cells)):
        pairs = [(i, j) for i in left for j in near[i] if j in left]
        pairs = pairs or [(i, j) for i in left for j in left if i != j]
        sides = [np.array([tree.boxes[i], tree.boxes[j]]) for i, j in pairs]
        sizes = [np.prod(both[:, 2:].max(0) - both[:, :2].min(0)) for both in sides]
        a, b = pairs[sizes.index(min(sizes))]
        assert tree.children[merged] == (a, b)
        near.append(HashSet())
        for node in [*near[a], *near[b]]:
            near[merged].add(node)
        for node in (a, b):
            near[merged].discard(node)
        for node in near[merged]:
            near[node].discard(a)
            near[node].discard(b)
            near[node].add(merged)
        left = [node for node in left if node not in (a, b)] + [merged]


def test_trees_deeper_than_a_path_are_refused(monkeypatch):
    assert order.DEEPEST == PATH
    design = compiled(3)
    depth = {body.name: tree_of(body).depth() for body in design.bodies + design.statics}
    most = max(depth["robot"], depth["box"]) + max(depth.values())
    monkeypatch.setattr(order, "DEEPEST", most)
    order_arrays(design)
    monkeypatch.setattr(order, "DEEPEST", most - 1)
    with pytest.raises(SimulationError):
        order_arrays(design)


def test_more_objects_than_a_key_tells_apart_are_refused(monkeypatch):
    monkeypatch.setattr(order, "MOST_OBJECTS", 3)
    order_arrays(compiled(3))
    monkeypatch.setattr(order, "MOST_OBJECTS", 2)
    with pytest.raises(SimulationError):
        order_arrays(compiled(3))
