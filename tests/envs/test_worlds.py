"""Terrains: run-length text, the worlds of the tasks, and what happens when a robot does not fit."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest
from hypothesis import given, strategies as st

from warpvox.design import example_design
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.worlds import block, columns, heights, rows, task_world
from warpvox.errors import WorldError
from warpvox.world import World

F, S = 5, 2


def test_rows_start_at_the_bottom() -> None:
    obj = rows("thing", "3F", ". F S", "FS", x=4, y=2)
    assert obj.grid.tolist() == [[F, S, 0], [0, F, S], [F, F, F]]
    assert (obj.name, obj.x, obj.y) == ("thing", 4, 2)


def test_columns_start_at_the_left_and_grow_upward() -> None:
    assert columns("thing", "3F", "F.S", "F").grid.tolist() == [[F, S, 0], [F, 0, 0], [F, F, F]]


def test_heights_make_solid_columns() -> None:
    assert heights("thing", "1x2 3 2").grid.tolist() == [[0, 0, F, 0], [0, 0, F, F], [F, F, F, F]]


def test_block_is_solid() -> None:
    assert block("thing", 3, 2, "S", x=3, y=6).grid.tolist() == [[S, S, S], [S, S, S]]


@given(st.lists(st.text("FS", min_size=1, max_size=6), min_size=1, max_size=6))
def test_columns_are_rows_turned_over(lines: list[str]) -> None:
    by_rows, by_columns = rows("thing", *lines), columns("thing", *lines)
    assert np.array_equal(by_rows.grid[::-1], by_columns.grid[::-1].T)


@pytest.mark.parametrize("line", ["3Q", "F3", "x", "2-F"])
def test_unreadable_lines_are_refused(line: str) -> None:
    with pytest.raises(WorldError, match="expected runs such as"):
        rows("thing", line)


@pytest.mark.parametrize("task", task_ids())
def test_worlds_have_the_checksums_of_the_reference(task: str) -> None:
    """Place, size and CRC of the cells of every object, as ``tests/parity/record.py --worlds`` has written them."""
    theirs = json.loads((Path(__file__).parent / "worlds.json").read_text())[task]
    ours = {
        obj.name: [obj.x, obj.y, obj.width, obj.height, crc32(obj.grid.tobytes())] for obj in get_task(task).objects
    }
    assert ours == theirs


OTHER_FILES = {"Catcher-v0": "Walker-v0"} | dict.fromkeys(
    ["AreaMaximizer-v0", "AreaMinimizer-v0", "WingspanMaximizer-v0", "HeightMaximizer-v0"], "ShapeChange"
)


def reference_world(name: str) -> World:
    found = find_spec("evogym")
    if found is None or not found.submodule_search_locations:
        pytest.skip("the reference is not installed")
    return World.from_json(Path(next(iter(found.submodule_search_locations))) / "envs" / "sim_files" / f"{name}.json")


@pytest.mark.parametrize("task", task_ids())
def test_terrain_equals_the_world_file_of_the_reference(task: str) -> None:
    theirs = reference_world(OTHER_FILES.get(task, task)).objects
    ours = {obj.name: obj for obj in get_task(task).objects}
    assert {name: ours[name] for name in theirs} == theirs
    for name in ours.keys() - theirs.keys():  # what the reference adds from files of single pieces
        size = ours[name].width
        kind = {"p": "package", "b": f"rigid_{size}x{size}"}[name[0]] if name[:3] != "peg" else "peg"
        (piece,) = reference_world(kind).objects.values()
        assert np.array_equal(ours[name].grid, piece.grid)


@pytest.mark.parametrize("task", task_ids())
def test_the_robot_stands_in_its_cell(task: str) -> None:
    body = example_design("walker")
    spec = get_task(task)
    world = task_world(spec, body)
    robot = world.objects["robot"]
    assert (robot.x, robot.y) == spec.robot_cell
    assert np.array_equal(robot.grid, body)
    assert len(world.objects) == len(spec.objects) + 1


def test_a_body_that_does_not_fit_is_refused_by_name_of_the_task() -> None:
    with pytest.raises(WorldError, match=r"5x6 body does not fit the world of Climber-v0: .*'pipe' at cell \(6, 1\)"):
        task_world(get_task("Climber-v0"), np.full((5, 6), 3, np.int8))


def test_connections_are_those_given() -> None:
    body = np.array([[3, 3], [4, 4]], np.int8)
    world = task_world(get_task("Walker-v0"), body, np.array([[0, 0, 1], [1, 2, 3]]))
    assert world.objects["robot"].connections.tolist() == [[0, 1], [0, 2], [1, 3]]
