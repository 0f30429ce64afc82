"""World files as EvoGym reads them: the width alone says where a cell lies, and the grid grows with its objects."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

import warpvox as wv
from warpvox.editor.documents import read_file
from warpvox.evogym.utils import Pair
from warpvox.evogym.world import EvoWorld, WorldObject

LINE = {"indices": [4, 5], "types": [5, 5], "neighbors": {"4": [5], "5": [4]}}
HEIGHTS = st.one_of(st.none(), st.integers(-3, 12), st.sampled_from([10**7, 10**40]))
"""Heights that a file may state; None: it states none."""


def near(cell: tuple[int, int]) -> list[tuple[int, int]]:
    x, y = cell
    return [(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)]


@st.composite
def documents(draw: st.DrawFn) -> tuple[dict[str, Any], dict[str, dict[tuple[int, int], int]]]:
    """A world file with one to three objects in columns of their own, and the type of each cell (x, y) of an object."""
    width, left = draw(st.integers(1, 14)), 0
    objects: dict[str, dict[str, Any]] = {}
    expected: dict[str, dict[tuple[int, int], int]] = {}
    for number in range(draw(st.integers(1, 3))):
        if left >= width:
            break
        right = draw(st.integers(left, width - 1))
        places = st.tuples(st.integers(left, right), st.integers(0, 9))
        cells = draw(st.dictionaries(places, st.integers(1, 5), min_size=1, max_size=8))
        number_of = {cell: cell[1] * width + cell[0] for cell in cells}
        objects[f"object {number}"] = {
            "indices": list(number_of.values()),
            "types": [float(cell) if draw(st.booleans()) else cell for cell in cells.values()],
            "neighbors": {
                str(number_of[cell]): [number_of[other] for other in near(cell) if other in cells] for cell in cells
            },
        }
        expected[f"object {number}"] = cells
        left = right + 1
    document = {"grid_width": width, "objects": objects}
    height = draw(HEIGHTS)
    return document | ({} if height is None else {"grid_height": height}), expected


def drawn(cells: dict[tuple[int, int], int]) -> np.ndarray:
    """The cells from (0, 0) on, row 0 at the bottom."""
    grid = np.zeros((max(y for _, y in cells) + 1, max(x for x, _ in cells) + 1), int)
    for (x, y), cell in cells.items():
        grid[y, x] = cell
    return grid


@given(documents())
def test_the_width_alone_says_where_cells_lie(
    tmp_path_factory: pytest.TempPathFactory, made: tuple[dict[str, Any], dict[str, dict[tuple[int, int], int]]]
) -> None:
    document, expected = made
    path = tmp_path_factory.mktemp("worlds") / "world.json"
    path.write_text(json.dumps(document))
    whole = drawn({place: cell for cells in expected.values() for place, cell in cells.items()})
    rows, columns = whole.shape

    world = wv.World.from_json(path)
    grid = world.grid()[::-1]
    np.testing.assert_array_equal(grid[:rows, :columns], whole)
    assert np.count_nonzero(grid) == np.count_nonzero(whole)
    stated = document.get("grid_height", 0)
    as_stated = rows <= stated and document["grid_width"] * stated <= 10**6
    assert (world.width, world.height) == ((document["grid_width"], stated) if as_stated else (columns, rows))
    for name, cells in expected.items():
        pairs = sum(other in cells for cell in cells for other in near(cell)) // 2
        assert len(world.objects[name].connections) == pairs

    drop_in = EvoWorld.from_json(str(path))
    np.testing.assert_array_equal(drop_in.grid, whole)
    assert drop_in.grid_size == Pair(columns, rows)
    for name, cells in expected.items():
        obj = WorldObject()
        obj.load_from_parsed_json(name, document["objects"][name], Pair(document["grid_width"], 1))
        assert {(obj.pos.x + cell.x, obj.pos.y + cell.y) for cell in obj.voxels} == set(cells)
        assert obj.get_connections().tolist() == drop_in.objects[name].get_connections().tolist()

    editor = np.array(read_file(path)["types"])[::-1]
    np.testing.assert_array_equal(editor[:rows, :columns], whole)


def test_a_low_height_is_no_part_of_the_world() -> None:
    world = wv.World.from_json({"grid_width": 4, "grid_height": 1, "objects": {"p": LINE}})
    assert (world.pretty(), world.objects["p"].y) == ("FF\n..", 1)
    assert wv.World.from_json({"grid_width": 4, "grid_height": 3, "objects": {"p": LINE}}).pretty().count("\n") == 2
    world.add_from_json({"grid_width": 9, "grid_height": 1, "objects": {"q": LINE}})
    assert (world.width, world.height) == (9, 2)


def test_a_robot_in_a_low_world_is_a_body(tmp_path: Path) -> None:
    robot = {"indices": [8, 9, 12], "types": [3, 4, 1.0], "neighbors": {"8": [9, 12], "9": [8], "12": [8]}}
    path = tmp_path / "world.json"
    path.write_text(json.dumps({"grid_width": 4, "grid_height": 2, "objects": {"ground": LINE, "robot": robot}}))
    assert wv.load_design(path).tolist() == [[1, 0], [3, 4]]


SQUARE = {
    "indices": [6, 7, 12, 13],
    "types": [1, 2, 3, 2],
    "neighbors": {"6": [7, 12], "7": [6, 13], "12": [6, 13], "13": [7, 12]},
}


def square(**changes: Any) -> dict[str, Any]:
    """A file with one object of 2 x 2 cells at (0, 1)."""
    return {"grid_width": 6, "grid_height": 4, "objects": {"p": SQUARE | changes}}


@pytest.mark.parametrize(
    "document",
    [
        square() | {"author": "somebody", "score": float("nan")},
        square(colour="red"),
        square(types=[1.0, 2.0, 3.0, 2.0]),
        square(neighbors={"6": [7.0, 12], "7": [6, 13], "12": [6, 13], "13": [7, 12]}),
        square(neighbors={"6": [7, 12], "7": [13], "12": [13], "13": []}),  # one direction of each
        square(neighbors=SQUARE["neighbors"] | {"6": [6, 7, 7, 12]}),  # itself, and one twice
        square(indices=[6, 7, 12, 13, 13], types=[1, 2, 3, 2, 2], neighbors=SQUARE["neighbors"] | {"x": []}),
    ],
)
def test_what_changes_nothing_is_read(document: dict[str, Any]) -> None:
    assert wv.World.from_json(document) == wv.World.from_json(square())
    assert wv.World.from_json(json.dumps(document)) == wv.World.from_json(square())


def test_empty_cells_make_the_box_larger() -> None:
    near = SQUARE["neighbors"] | {"13": [7, 12, 14], "14": [13]}
    obj = wv.World.from_json(square(indices=[6, 7, 12, 13, 14], types=[1, 2, 3, 2, 0], neighbors=near)).objects["p"]
    assert obj.grid.tolist() == [[3, 2, 0], [1, 2, 0]]
    assert obj.connections.tolist() == [[0, 1], [0, 3], [1, 4], [3, 4]]


def test_cells_that_do_not_touch_are_not_connected() -> None:
    """Lists of neighbours made with index - 1 and index + 1 alone, which go around at the ends of rows."""
    indices = list(range(12))
    near = {str(n): [other for other in (n - 1, n + 1, n - 6, n + 6) if other in indices] for n in indices}
    entry = {"indices": indices, "types": [5] * 12, "neighbors": near}
    ground = wv.World.from_json({"grid_width": 6, "grid_height": 1, "objects": {"ground": entry}}).objects["ground"]
    assert ground == wv.WorldObject.from_array("ground", np.full((2, 6), 5))


WRONG_FILES = [
    "{",
    '{"grid_width": 1, "grid_height": 1, "objects": {"a": 1, "a": 2}}',
    "nowhere.json",
    7,
    {"objects": {}},
    square() | {"grid_height": "4"},
    square() | {"grid_width": 0},
    square() | {"objects": []},
    square(neighbors=SQUARE["neighbors"] | {"99": []}),
    square(box=[0, 0, 2, 2]),
]
WRONG_OBJECTS = [
    square() | {"grid_width": 10**9},
    *(square(indices=[6, 7, 12, last]) for last in ("13", 12, 10**12 + 6 * 10**9)),
    *(square(indices=indices) for indices in ([], 5, [-6, -5, 0, 1])),
    *(square(types=[first, 2, 3, 2]) for first in (2.5, True, "1", 6)),
    *(square(types=types) for types in ([1, 2], [0, 0, 0, 0])),
    square(neighbors={"6": [7, 12], "7": [6, 13], "12": [6, 13]}),
    *(square(neighbors=SQUARE["neighbors"] | {"6": [other]}) for other in (8, 13)),  # EvoGym joins far corners of 13
    {"grid_width": 6, "grid_height": 4, "objects": {"p": {"indices": [1], "types": [1]}}},
]


@pytest.mark.parametrize("document", [*WRONG_FILES, *WRONG_OBJECTS], ids=str)
def test_what_contradicts_itself_is_refused_and_changes_nothing(document: Any) -> None:
    world = wv.World(9, 2)
    world.add_from_array("ground", np.full((1, 9), 5), 0, 0)
    before = world.key()
    with pytest.raises(wv.WorldError):
        world.add_from_json(document)
    assert world.key() == before
    if document in WRONG_OBJECTS:
        with pytest.raises(wv.WorldError):
            WorldObject().load_from_parsed_json("p", document["objects"]["p"], Pair(document["grid_width"], 4))
