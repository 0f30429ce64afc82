import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

import warpvox as wv
from warpvox.design import full_connections

CELLS = hnp.arrays(np.int8, hnp.array_shapes(min_dims=2, max_dims=2, max_side=4), elements=st.integers(0, 5)).filter(
    np.any
)
PLACES = st.tuples(st.integers(0, 9), st.integers(0, 7))
OBJECTS = st.lists(st.tuples(CELLS, PLACES), min_size=1, max_size=5)


@st.composite
def worlds(draw: st.DrawFn) -> wv.World:
    """Worlds with objects wherever they fit, some of their connections cut."""
    world = wv.World(draw(st.integers(1, 12)), draw(st.integers(1, 9)))
    for number, (cells, (x, y)) in enumerate(draw(OBJECTS)):
        pairs = full_connections(cells)
        keep = draw(hnp.arrays(bool, len(pairs)))
        try:
            world.add_from_array(f"object {number}", cells, x, y, pairs[keep].T)
        except wv.WorldError:
            continue
    return world


def walker_world() -> wv.World:
    world = wv.World(20, 1)
    world.add_from_array("ground", np.full((1, 20), 5), 0, 0)
    world.add_from_array("robot", wv.example_design("walker"), 1, 1)
    return world


@given(OBJECTS)
def test_overlap_rule_equals_a_painted_grid(objects: list[tuple[np.ndarray, tuple[int, int]]]) -> None:
    canvas = np.zeros((20, 20), int)  # row 0 at the bottom: [y, x]
    world = wv.World()
    for number, (cells, (x, y)) in enumerate(objects):
        rows, columns = cells.shape
        box = canvas[y : y + rows, x : x + columns]
        if box.any():
            with pytest.raises(wv.WorldError):
                world.add_from_array(str(number), cells, x, y)
        else:
            world.add_from_array(str(number), cells, x, y)
            box[:] = cells[::-1]
    assert np.array_equal(world.grid(), canvas[: world.height, : world.width][::-1])
    assert not canvas[world.height :].any()
    assert not canvas[:, world.width :].any()


def test_a_bounding_box_counts_with_its_empties_only_for_the_new_object() -> None:
    frame = np.array([[5, 5, 5], [5, 0, 5], [5, 5, 5]])
    world = wv.World()
    world.add_from_array("frame", frame, 0, 0)
    world.add_from_array("inside", [[2]], 1, 1)  # lies in an empty cell of the frame
    assert world.remove_object("frame").name == "frame"
    with pytest.raises(wv.WorldError):
        world.add_from_array("frame", frame, 0, 0)


def test_the_grid_grows_and_never_shrinks() -> None:
    world = wv.World(4, 2)
    world.add_from_array("a", [[1, 1]], 5, 0)
    assert (world.width, world.height) == (7, 2)
    world.add_from_array("b", [[1], [1], [1]], 0, 1)
    assert (world.width, world.height) == (7, 4)
    world.remove_object("b")
    assert (world.width, world.height) == (7, 4)


def test_moving() -> None:
    world = walker_world()
    world.add_from_array("box", [[2]], 12, 1)
    moved = world.move_object("robot", 3, 1)  # over cells that it covered itself
    assert (moved.x, moved.y) == (3, 1)
    assert list(world.objects) == ["ground", "box", "robot"]
    for x, y in ((9, 1), (3, 0), (-1, 1)):
        with pytest.raises(wv.WorldError):
            world.move_object("robot", x, y)
        assert world.objects["robot"] is moved


def test_what_moved_into_the_box_of_another_can_be_read_back() -> None:
    world = wv.World()
    world.add_from_array("robot", [[3, 4]], 5, 0)
    world.add_from_array("walls", [[5, 0, 0, 5], [5, 5, 5, 5]], 0, 0)
    world.move_object("robot", 1, 1)
    assert wv.World.from_json(world.to_json()) == world
    with pytest.raises(wv.WorldError):
        world.move_object("robot", 10**6, 10**6)
    assert world.objects["robot"].x == 1


@pytest.mark.parametrize(
    "arguments",
    [
        ("robot", [[3]], 0, 9),
        ("", [[3]], 0, 9),
        ("a", [[0]], 0, 9),
        ("a", [[9]], 0, 9),
        ("a", [[3]], -1, 9),
        ("a", [[3]], 2, 2),
        ("a", [[3, 3]], 0, 9, [[0], [1, 2]]),
        ("a", [[3, 3]], 0, 9, [[0, 1], [1, 0], [0, 1]]),
    ],
)
def test_bad_objects_change_nothing(arguments: tuple[object, ...]) -> None:
    world = walker_world()
    before = world.key()
    with pytest.raises(wv.WorldError):
        world.add_from_array(*arguments)
    assert world.key() == before


def test_unknown_names_and_sizes() -> None:
    with pytest.raises(wv.WorldError):
        walker_world().remove_object("robo")
    for name in ([], {}, 5, "rob"):
        with pytest.raises(wv.WorldError):
            walker_world().remove_object(name)
        with pytest.raises(wv.WorldError):
            walker_world().move_object(name, 0, 0)
    with pytest.raises(wv.WorldError):
        wv.World(0, 5)
    with pytest.raises(wv.WorldError):
        wv.World(5, 2.5)


@given(CELLS)
def test_default_connections_are_all_neighbours_sorted(cells: np.ndarray) -> None:
    obj = wv.WorldObject.from_array("a", cells)
    assert obj.connections.dtype == np.int32
    assert not any(array.flags.writeable for array in (obj.grid, obj.connections))
    pairs = obj.connections.tolist()
    assert pairs == sorted(pairs)
    assert sorted(full_connections(cells).tolist()) == pairs


def test_given_connections_are_sorted_and_unique() -> None:
    obj = wv.WorldObject.from_array("a", [[1, 1], [1, 1]], 0, 0, np.array([[3, 1, 0, 2], [2, 0, 1, 3.0]]))
    assert obj.connections.tolist() == [[0, 1], [2, 3]]
    alone = wv.WorldObject.from_array("a", [[1, 1]], 0, 0, np.empty((2, 0)))
    assert alone.connections.shape == (0, 2)
    assert alone != wv.WorldObject.from_array("a", [[1, 1]])


def test_keys_tell_worlds_apart_but_not_orders() -> None:
    base = walker_world()
    keys = {base.key()}
    shifted, renamed, cut, wider = (wv.World(20, 1) for _ in range(4))
    for world in (shifted, renamed, cut):
        world.add_from_array("ground", np.full((1, 20), 5), 0, 0)
    body = wv.example_design("walker")
    shifted.add_from_array("robot", body, 2, 1)
    renamed.add_from_array("robots", body, 1, 1)
    cut.add_from_array("robot", body, 1, 1, full_connections(body)[1:].T)
    wider.add_from_array("ground", np.full((1, 21), 5), 0, 0)
    wider.add_from_array("robot", body, 1, 1)
    keys |= {world.key() for world in (shifted, renamed, cut, wider)}
    assert len(keys) == 5
    reverse = wv.World(20, 1)
    reverse.add_from_array("robot", body, 1, 1)
    reverse.add_from_array("ground", np.full((1, 20), 5), 0, 0)
    assert reverse.key() == base.key()
    assert reverse == base


def test_drawing() -> None:
    world = wv.World(4, 1)
    world.add_from_array("ground", [[5, 5, 5]], 0, 0)
    world.add_from_array("robot", [[3, 4], [1, 2]], 1, 1)
    assert world.pretty() == ".HV.\n.RS.\nFFF."


@given(worlds())
def test_json_round_trip(tmp_path_factory: pytest.TempPathFactory, world: wv.World) -> None:
    path = tmp_path_factory.mktemp("worlds") / "world.json"
    text = world.to_json(path)
    for source in (text, path, str(path), json.loads(text)):
        again = wv.World.from_json(source)
        assert again == world
        assert list(again.objects) == list(world.objects)


HAND_MADE = {
    "grid_width": 4,
    "grid_height": 3,
    "objects": {
        "peg": {
            # x = 1..2, y = 1..2; the cells come in no particular order, (2, 2) is not connected to (1, 2)
            "indices": [9, 5, 6, 10],
            "types": [2, 1, 5, 3],
            "neighbors": {"5": [6, 9], "6": [5, 10], "9": [5], "10": [6]},
        }
    },
}


def test_a_file_made_by_hand() -> None:
    world = wv.World.from_json(HAND_MADE)
    peg = world.objects["peg"]
    assert (world.width, world.height, peg.x, peg.y) == (4, 3, 1, 1)
    assert peg.grid.tolist() == [[2, 3], [1, 5]]
    assert peg.connections.tolist() == [[0, 2], [1, 3], [2, 3]]
    entry = json.loads(world.to_json())["objects"]["peg"]
    assert set(entry) == {"indices", "types", "neighbors"}
    assert dict(zip(entry["indices"], entry["types"], strict=True)) == {9: 2, 10: 3, 5: 1, 6: 5}
    assert {k: sorted(v) for k, v in entry["neighbors"].items()} == HAND_MADE["objects"]["peg"]["neighbors"]


def test_adding_a_file_to_a_world_is_all_or_nothing(tmp_path: Path) -> None:
    both = wv.World(9, 9)
    both.add_from_array("free", [[1]], 8, 8)
    both.add_from_array("blocked", [[1]], 1, 0)
    both.to_json(tmp_path / "both.json")
    world = walker_world()
    with pytest.raises(wv.WorldError):
        world.add_from_json(tmp_path / "both.json")
    assert list(world.objects) == ["ground", "robot"]
    both.move_object("blocked", 7, 7)
    world.add_from_json(both.to_json())
    assert list(world.objects) == ["ground", "robot", "free", "blocked"]
    assert (world.width, world.height) == (20, 9)
