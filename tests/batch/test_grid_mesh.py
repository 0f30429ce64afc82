"""Meshes of different bodies in one pack, against the mesh of each body by itself."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from warpvox.batch.grid_mesh import GridMesh, RobotBodies, most_points
from warpvox.compile import Body, mesh
from warpvox.design import full_connections
from warpvox.types import Cell, Physics
from warpvox.world import WorldObject


def robots(rng: np.random.Generator, count: int, cut: bool, fixed: bool) -> list[WorldObject]:
    """Random bodies of any shape, connected or not; ``cut``: some neighbours are not connected."""
    made = []
    while len(made) < count:
        grid = rng.choice(6 if fixed else 5, size=rng.integers(1, 6, 2)).astype(np.int8)
        pairs = full_connections(grid)
        kept = pairs[rng.random(len(pairs)) < 0.7] if cut else pairs
        if grid.any() and len(kept):
            made.append(WorldObject.from_array("robot", grid, 2, 1, kept.T))
    return made


class Lane:
    """One lane of a mesh, with the numbers that the body's own mesh has."""

    def __init__(self, meshes: GridMesh, lane: int) -> None:
        self.meshes, self.lane = meshes, lane
        self.order = meshes.order[0, lane][: meshes.count[0, lane]].tolist()
        self.number = {point: n for n, point in enumerate(self.order)}

    def point(self, row: int) -> int:
        return self.number[row // 4 * 4 + int(self.meshes.leader[0, row, self.lane])]

    def ends(self, spring: int) -> tuple[int, ...]:
        return tuple(sorted(self.point(int(row)) for row in self.meshes.ends[0, spring]))

    def springs(self) -> list[tuple]:
        meshes, lane = self.meshes, self.lane
        rows = np.flatnonzero(meshes.spring[0, :, lane])
        return sorted(
            (self.ends(s), meshes.springs.rest[s], meshes.stiffness[0, s, lane],
             tuple(sorted(a for a in meshes.drive[0, s, :, lane].tolist() if a >= 0)))
            for s in rows
        )  # fmt: skip

    def rigid(self) -> list[tuple[int, ...]]:
        cells, sides = np.nonzero(self.meshes.rigid[0, :, :, self.lane])
        return [self.ends(s) for s in self.meshes.springs.of_cell[cells, sides]]


def own_springs(body: Body) -> list[tuple]:
    return sorted(
        (tuple(sorted((a, b))), rest, k, tuple(sorted(body.drives.get(s, ()))))
        for s, (a, b, rest, k) in enumerate(body.springs)
        if not (body.fixed[a] and body.fixed[b]) or s in body.drives
    )


def own_rigid(body: Body) -> list[tuple[int, ...]]:
    sides = [s for c in body.cells if body.kind(c) == Cell.RIGID for s in body.sides[c]]
    return [
        tuple(sorted((a, b)))
        for s, (a, b, *_) in ((s, body.springs[s]) for s in sides)
        if not (body.fixed[a] and body.fixed[b]) or s in body.drives
    ]


@given(
    seed=st.integers(0, 10**6), lanes=st.sampled_from([1, 8, 32]), cut=st.booleans(), fixed=st.booleans(),
    preset=st.sampled_from(["evogym", "paper"]),
)  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_every_lane_has_the_mesh_of_its_body(seed: int, lanes: int, cut: bool, fixed: bool, preset: str) -> None:
    physics = Physics.preset(preset)
    objects = robots(np.random.default_rng(seed), lanes, cut, fixed)
    bodies = RobotBodies.of(objects)
    meshes = GridMesh(bodies, np.arange(lanes)[None], (objects[0].x, objects[0].y), physics)
    for k, obj in enumerate(objects):
        lane, body = Lane(meshes, k), mesh(obj, physics)
        positions = [tuple(meshes.position[0, row // 4, :, k]) for row in lane.order]
        assert positions == body.points  # to the last bit, in their order
        assert [bool(meshes.fixed[0, row, k]) for row in lane.order] == body.fixed
        assert lane.springs() == own_springs(body)
        assert lane.rigid() == own_rigid(body)
        assert meshes.actions[0, k] == obj.num_actuators
        top = meshes.rows - obj.height
        for cell, corners in body.corners.items():
            at = (cell[0] + top) * meshes.columns + cell[1]
            assert [lane.point(int(row)) for row in meshes.corner[0, at]] == corners
            bits = sum(1 << side for side in range(4) if meshes.side[0, at, side, k])
            assert bits == body.surface.get(cell, 0)
        assert meshes.side[0, :, :, k].any(1).sum() == len(body.surface)


@given(seed=st.integers(0, 10**6), cut=st.booleans())
@settings(max_examples=20, deadline=None)
def test_twins_are_pulled_by_the_springs_of_their_leaders(seed: int, cut: bool) -> None:
    objects = robots(np.random.default_rng(seed), 8, cut, False)
    meshes = GridMesh(RobotBodies.of(objects), np.arange(8)[None], (2, 1), Physics())
    for k in range(8):
        lane = Lane(meshes, k)
        springs = np.flatnonzero(meshes.spring[0, :, k])
        for row in np.flatnonzero(meshes.point[0, :, k]):
            places = np.flatnonzero(meshes.link[0, row, :, k])
            found = sorted(meshes.springs.at_node[row // 4, places].tolist())
            assert found == [s for s in springs if lane.point(row) in lane.ends(s)]


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (2, 3), (5, 5)])
def test_no_body_has_more_points_than_there_is_room_for(rows: int, columns: int) -> None:
    board = np.indices((rows, columns)).sum(0) % 2
    for grid in (np.full((rows, columns), 3), np.where(board == 0, 3, 0), np.where(board == 1, 3, 0)):
        if grid.any():
            points = len(mesh(WorldObject.from_array("robot", grid), Physics()).points)
            assert points <= most_points(rows, columns)
    lonely = WorldObject.from_array("robot", np.full((rows, columns), 3), 0, 0, np.zeros((2, 0), int))
    assert len(mesh(lonely, Physics()).points) == most_points(rows, columns, cut=True)
