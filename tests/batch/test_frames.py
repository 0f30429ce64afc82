"""Tables of packs of different bodies: which springs pull at which points, by a second way to find that out."""

import numpy as np
import pytest
from worlds import ground, world

from warpvox.batch.frames import Frame
from warpvox.design import full_connections
from warpvox.types import VOXEL, Physics
from warpvox.world import World

LANES = 8


def drawn(rng: np.random.Generator, cut: bool) -> World:
    """A random body, with ``cut`` one whose neighbours are not all connected, beside a box and terrain."""
    grid = rng.integers(0, 5, (4, 4)).astype(np.int8)
    pairs = full_connections(grid)
    kept = pairs[rng.random(len(pairs)) < 0.7] if cut else pairs
    return world(20, 10, box=(np.full((2, 2), 2), 10, 1), ground=ground(20), robot=(grid, 1, 1, kept.T))


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_points_feel_the_springs_of_all_points_that_they_are_one_with(seed: int, cut: bool) -> None:
    rng = np.random.default_rng(seed)
    frame = Frame([drawn(rng, cut) for _ in range(LANES)], Physics(), ())
    tables = {name: values[0] for name, values in frame.tables(np.arange(LANES)[None]).items()}
    points, springs, twins = (int(tables[name]) for name in ("points", "springs", "twins"))
    ends, more = tables["spring_ends"][:springs], tables["twin_end"][: tables["twin_ends"]]
    assert twins
    pull = rng.integers(1, 100, (springs, LANES)) * (tables["spring_k"][:springs] != 0)
    force, touched = np.zeros((points, LANES), int), {p: {-1} for p in range(points)}
    for s, pair in enumerate(ends):
        for end, p in enumerate(pair):
            force[p] += pull[s] * (-1) ** end
            touched[p].add(s)
    for s, p, end, lanes in more:
        force[p] += pull[s] * (-1) ** end * (lanes >> np.arange(LANES) & 1)
        touched[p].add(s)
    for k in range(LANES):
        leader = np.arange(points)
        for (p, q), lanes in zip(tables["twin"][:twins], tables["twin_lanes"][:twins], strict=True):
            leader[p] = q if lanes >> k & 1 else leader[p]
        whole = np.zeros(points, int)
        np.add.at(whole, leader[ends[:, 0]], pull[:, k])
        np.add.at(whole, leader[ends[:, 1]], -pull[:, k])
        assert force[:, k].tolist() == whole[leader].tolist()
    active = tables["active"][: 2 * tables["actives"] : 2] // 2
    last = tables["last_spring"][: tables["actives"]].tolist()
    assert last == sorted(last) == [max(touched[p]) for p in active]
    assert set(active) >= {p for p in range(points) if touched[p] != {-1}}


def test_points_that_rest_come_last() -> None:
    """A shelf hangs between fixed cells, behind an anvil that never moves."""
    blocks = dict(anvil=([[5, 5]], 16, 3), shelf=([[5, 2, 2, 5, 5]], 9, 3), robot=([[1, 3]], 2, 1))
    frame = Frame([world(20, 10, **blocks)], Physics(), ("anvil",))
    tables = {name: values[0] for name, values in frame.tables(np.zeros((1, 1), int)).items()}
    place = tables["rest_pos"].reshape(-1, 2)
    assert place[tables["order"][6:, 0]].tolist() == [[*point] for body in frame.others.bodies for point in body.points]
    assert sorted(tables["active"]) == [*range(2 * tables["actives"])]
    assert tables["actives"] < tables["points"]
    ends = place[tables["spring_ends"]]
    assert np.allclose(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), tables["spring_rest"])
    top_left, _, bottom_right, _ = place[tables["corner"]].transpose(1, 0, 2)
    assert np.allclose(bottom_right - top_left, [VOXEL, -VOXEL])
    springs = np.split(tables["link"], tables["link_start"][1:-1])
    assert all(tables["spring_ends"][max(s, -1 - s), int(s < 0)] == p for p, own in enumerate(springs) for s in own)
