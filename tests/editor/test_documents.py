"""Documents: what is drawn becomes a body or a world, and comes back from a file unchanged."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from refusals import refused

from warpvox.design import example_designs, load_design, sample_design
from warpvox.editor import trials
from warpvox.editor.documents import (
    check,
    check_file_name,
    design_of,
    document_of,
    file_names,
    read_file,
    save_file,
    world_of,
)
from warpvox.editor.trials import LONGEST, MOST_MOVING
from warpvox.envs.registry import get_task
from warpvox.errors import WarpvoxError
from warpvox.world import World

try_out = partial(trials.try_out, tasks={"Walker-v0": get_task("Walker-v0")})


def body_document(rows: list[list[int]]) -> dict:
    return document_of(np.array(rows))


def world_document(rows: list[list[int]], owners: list[list[int]], names: list[str]) -> dict:
    return {"kind": "world", "names": names, "types": rows, "owners": owners}


@given(seed=st.integers(0, 10_000), rows=st.integers(1, 6), columns=st.integers(2, 6), left=st.integers(0, 3))
def test_a_body_survives_painting_and_saving(tmp_path_factory, seed, rows, columns, left) -> None:
    body = sample_design((rows, columns), seed)
    grid = np.pad(body, ((1, 0), (left, 2)))  # painted anywhere on a larger grid
    trimmed = body[np.ix_(body.any(axis=1), body.any(axis=0))]
    np.testing.assert_array_equal(design_of(document_of(grid)), trimmed)
    folder = tmp_path_factory.mktemp("saved")
    path = save_file(document_of(grid), folder, "a_body")
    np.testing.assert_array_equal(load_design(path), trimmed)
    np.testing.assert_array_equal(read_file(path)["types"], trimmed)
    world = World.from_json(path)  # EvoGym's format as well
    np.testing.assert_array_equal(world.objects["robot"].grid, trimmed)
    assert (world.width, world.height) == trimmed.shape[::-1]


@given(seed=st.integers(0, 10_000), gap=st.integers(0, 3), height=st.integers(0, 2))
def test_a_world_survives_painting_and_saving(tmp_path_factory, seed, gap, height) -> None:
    world = World(30, 12)
    world.add_from_array("terrain", np.array([[5, *[0] * 28, 5], [5] * 30]), 0, 0)
    world.add_from_array("robot", sample_design((4, 4), seed), 2 + gap, 1 + height)
    world.add_from_array("box", np.full((2, 2), 1), 15, 1)
    assert world_of(document_of(world)).grid().tolist() == world.grid().tolist()
    path = save_file(document_of(world), tmp_path_factory.mktemp("saved"), "a_world")
    again = World.from_json(path)
    assert again.grid().tolist() == world.grid().tolist()
    assert set(again.objects) == set(world.objects)
    for name, obj in world.objects.items():
        np.testing.assert_array_equal(again.objects[name].connections, _trimmed(obj).connections)


def _trimmed(obj):
    """An object without the empty border that drawing cannot keep."""
    rows, columns = obj.grid.any(axis=1), obj.grid.any(axis=0)
    return type(obj).from_array(obj.name, obj.grid[np.ix_(rows, columns)], 0, 0)


def test_objects_that_touch_stay_apart() -> None:
    document = world_document([[3, 2], [5, 5]], [[0, 1], [2, 2]], ["robot", "box", "ground"])
    world = world_of(document)
    assert {name: obj.grid.tolist() for name, obj in world.objects.items()} == {
        "robot": [[3]], "box": [[2]], "ground": [[5, 5]]
    }  # fmt: skip
    assert (world.objects["box"].x, world.objects["box"].y) == (1, 1)


def test_terrain_may_reach_around_a_robot() -> None:
    rows = [[5, 0, 0, 5], [5, 3, 4, 5], [5, 5, 5, 5]]
    owners = [[0, 0, 0, 0], [0, 1, 1, 0], [0, 0, 0, 0]]
    # whichever comes first in the list of names
    for names in (["ground", "robot"], ["robot", "ground"]):
        turned = owners if names[0] == "ground" else (1 - np.array(owners)).tolist()
        assert set(world_of(world_document(rows, turned, names)).objects) == {"ground", "robot"}


BODY = body_document([[3, 3], [4, 0]])
WORLD = world_document([[3, 0], [5, 5]], [[0, 0], [1, 1]], ["robot", "ground"])


@pytest.mark.parametrize(
    ("document", "words"),
    [
        ({}, "a body or a world"),
        (BODY | {"types": "33"}, "rows of cells"),
        (BODY | {"types": [[3] * 33]}, "room for 32 columns"),
        (BODY | {"types": [[3, 3], [3]]}, "same number of cells"),
        (WORLD | {"types": [[0, 0], [0, 0]]}, "world is empty"),
        (WORLD | {"types": [[5] * 401], "owners": [[0] * 401]}, "room for 400 columns"),
        (WORLD | {"owners": [[0, 0], [1, 2]]}, "number of one of the names"),
        (WORLD | {"owners": [[0, 0]]}, "an entry for every cell"),
        (WORLD | {"names": ["robot", "robot"]}, "must differ"),
        (WORLD | {"names": []}, "list of texts"),
        (WORLD | {"names": [f"o{k}" for k in range(65)]}, "up to 64 objects"),
        (
            world_document([[3, 1, 3], [1, 3, 1], [3, 1, 3]], [[0, 1, 0], [1, 0, 1], [0, 1, 0]], ["a", "b"]),
            "overlaps",
        ),
    ],
)  # fmt: skip
def test_what_is_not_valid_is_named(document: dict, words: str) -> None:
    with refused(WarpvoxError, words):
        check(document)


@pytest.mark.parametrize("name", ["../x", "a/b", "", ".hidden", "a\\b", "x" * 65, "a\0b", 5, None, "C:", "-x"])
def test_names_lead_nowhere_else(name: object) -> None:
    with pytest.raises(WarpvoxError):
        check_file_name(name)


def test_names_fit_the_file_system() -> None:
    assert check_file_name("a" * 64) == "a" * 64 + ".json"
    assert check_file_name("über") == "über.json"
    with pytest.raises(WarpvoxError):
        check_file_name("a" + "𠀀" * 63)


def test_files_are_not_replaced_unasked(tmp_path: Path) -> None:
    path = save_file(BODY, tmp_path, "robot")
    before = path.read_bytes()
    with pytest.raises(FileExistsError):
        save_file(WORLD, tmp_path, "robot.json")
    assert path.read_bytes() == before
    save_file(WORLD, tmp_path, "robot", overwrite=True)
    assert read_file(path)["kind"] == "world"
    assert file_names(tmp_path) == ["robot.json"]
    assert file_names(tmp_path / "nothing") == []
    with refused(WarpvoxError, "Did you mean 'robot'"):
        read_file(tmp_path / "robt.json")
    with refused(WarpvoxError, "no file 'best.json' in") as caught:
        read_file(tmp_path / "best.json")
    assert "?" not in str(caught.value)  # all names end alike


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"[1, 2]", "must have two dimensions"),
        (b"null", "must hold numbers"),
        (b"{broken", "not a JSON file"),
        (b'{"body": [[9]]}', "unknown cell type"),
        (json.dumps({"body": [[3] * 40]}).encode(), "up to 32"),
        (b'{"objects": {}}', "lacks"),
        (b" " * 4_000_001, "are the limit"),
    ],
)
def test_files_that_cannot_be_shown_are_refused(tmp_path: Path, content: bytes, words: str) -> None:
    path = tmp_path / "file.json"
    path.write_bytes(content)
    with refused(WarpvoxError, words):
        read_file(path)


def test_rows_alone_are_a_body_as_for_a_search(tmp_path: Path) -> None:
    path = tmp_path / "rows.json"
    path.write_text("[[3, 4], [1, 2]]")
    assert read_file(path)["types"] == load_design(path).tolist() == [[3, 4], [1, 2]]


def test_an_empty_world_has_an_object_to_paint(tmp_path: Path) -> None:
    World(4, 3).to_json(tmp_path / "empty.json")
    assert read_file(tmp_path / "empty.json")["names"] == ["object"]


def test_cut_connections_are_refused_not_lost(tmp_path: Path) -> None:
    world = World(4, 4)
    world.add_from_array("robot", [[3, 4]], 0, 0, connections=np.zeros((2, 0), int))
    world.to_json(tmp_path / "cut.json")
    with pytest.raises(WarpvoxError):
        read_file(tmp_path / "cut.json")


def test_a_world_is_tried_out_as_it_stands() -> None:
    world = World(20, 8)
    world.add_from_array("ground", np.full((1, 20), 5), 0, 0)
    world.add_from_array("robot", example_designs()["mini"], 3, 1)
    rollout = try_out(document_of(world), "sine", 0.2, 3, None)
    assert rollout.num_steps == 10
    moved = rollout.positions[:, 0, rollout.scene(0).robot_points, 0].mean(axis=1)
    np.testing.assert_allclose(rollout.returns[:, 0], moved - moved[0], atol=1e-5)


def test_a_world_without_a_robot_falls() -> None:
    document = world_document([[2, 2], [0, 0], [0, 0]], [[0, 0]] * 3, ["box"])
    rollout = try_out(document, "zero", 0.2, 0, None)
    assert rollout.positions[-1, 0, :, 1].mean() < rollout.positions[0, 0, :, 1].mean() - 0.005
    assert rollout.returns[-1, 0] == 0


@pytest.mark.parametrize(
    ("document", "settings", "words"),
    [
        (BODY, {"agent": "sin"}, "agent must be"),
        (BODY, {"seconds": LONGEST + 1}, "seconds must be"),
        (BODY, {"seed": -1}, "seed must be"),
        (BODY, {"task": "Walkr-v0"}, "Did you mean 'Walker-v0'"),
        (BODY, {"task": None}, "id of a task"),
        (world_document([[5, 5]], [[0, 0]], ["floor"]), {}, "Nothing in this world moves"),
        (
            world_document([[2] * 100] * 20, [[0] * 100] * 20, ["jelly"]),
            {},
            f"up to {MOST_MOVING}",
        ),
    ],
)
def test_trials_have_limits(document: dict, settings: dict, words: str) -> None:
    asked = {"agent": "sine", "seconds": 0.1, "seed": 0, "task": "Walker-v0"} | settings
    with refused(WarpvoxError, words):
        try_out(document, **asked)


def test_a_trial_that_takes_too_long_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("warpvox.editor.trials.TIME_LIMIT", -1.0)
    with pytest.raises(WarpvoxError):
        try_out(BODY, "sine", 0.1, 0, "Walker-v0")
