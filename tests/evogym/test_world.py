"""Worlds, objects, constants, sampling and helpers of the drop-in."""

import random
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

import warpvox.evogym as evogym
from warpvox.design import check_design
from warpvox.envs.registry import get_task, released_id, task_ids
from warpvox.errors import WorldError
from warpvox.evogym import EvoWorld, Pair, WorldObject
from warpvox.evogym.envs import BenchmarkBase
from warpvox.evogym.errors import ArgumentTypeError, RangeError
from warpvox.world import World

BODY = np.array([[3, 0, 1], [4, 2, 2]])


@pytest.fixture
def world() -> EvoWorld:
    made = EvoWorld()
    made.add_from_array("ground", np.full((1, 8), 5), 0, 0)
    made.add_from_array("robot", BODY, 2, 1)
    return made


def test_rows_count_upward(world: EvoWorld) -> None:
    assert world.grid.tolist() == [[5] * 8, [0, 0, 4, 2, 2, 0, 0, 0], [0, 0, 3, 0, 1, 0, 0, 0]]
    assert world.grid_size == Pair(8, 3)
    robot = world.objects["robot"]
    assert robot.get_pos() == (2, 1)
    assert robot.grid.tolist() == BODY[::-1].tolist()
    assert np.array_equal(robot.get_structure(), BODY)
    for kind in ("float64", "int8"):  # as in the release
        assert WorldObject.from_array("robot", BODY.astype(kind)).get_structure().dtype == kind
    assert Pair(1, 1) not in robot.voxels
    assert set(robot.neighbors[Pair(0, 0)]) == {Pair(1, 0), Pair(0, 1)}


def test_connections_are_told_both_ways() -> None:
    obj = WorldObject.from_array("robot", BODY, np.array([[0, 3], [3, 4]]))
    assert sorted(map(tuple, obj.get_connections().T.tolist())) == [(0, 3), (3, 0), (3, 4), (4, 3)]
    alone = WorldObject.from_array("cell", np.array([[1]]))
    assert alone.get_connections().shape == (2, 0)


def test_objects_are_moved_and_removed(world: EvoWorld) -> None:
    world.translate_object("robot", 3, 1)
    assert world.objects["robot"].get_pos() == (5, 2)
    assert world.grid[1].sum() == 0
    assert world.grid_size == Pair(8, 4)
    world.move_object("robot", 0, 1)
    taken = world.remove_object("robot")
    assert taken.get_pos() == (0, 1)
    assert world.grid[1:].sum() == 0
    assert list(world.objects) == ["ground"]


def test_what_lies_in_the_hole_of_an_object_stays() -> None:
    world = EvoWorld()
    world.add_from_array("ring", np.array([[5, 5, 5], [5, 0, 5], [5, 5, 5]]), 0, 0)
    world.add_from_array("robot", [[3]], 1, 1)
    with pytest.raises(WorldError):
        world.move_object("ring", 0, 1)
    world.remove_object("ring")
    assert world.grid.tolist() == [[0, 0, 0], [0, 3, 0], [0, 0, 0]]


def test_what_cannot_be_done_changes_nothing(world: EvoWorld) -> None:
    grid = world.grid.copy()
    for wrong, words in (
        (lambda: world.move_object("robot", 1, 0), "overlaps"),
        (lambda: world.translate_object("robot", -3, 0), "negative"),
        (lambda: world.move_object("robot", 10**6, 10**6), "are the limit"),
        (lambda: world.move_object("robots", 0, 1), "Did you mean 'robot'"),
        (lambda: world.remove_object("box"), "no object named 'box'"),
        (lambda: world.add_from_array("robot", BODY, 5, 1), "already"),
        (lambda: world.add_from_array("box", BODY, 4, 1), "overlaps another one at cell (4, 1)"),
    ):
        with refused(ValueError, words):
            wrong()
        assert np.array_equal(world.grid, grid)
        assert world.objects["robot"].get_pos() == (2, 1)


def test_places_are_whole_numbers(world: EvoWorld) -> None:
    for place in (None, "3", 3.0):
        with pytest.raises(TypeError):
            world.move_object("robot", place, 1)


def test_copies_are_independent(world: EvoWorld) -> None:
    other = world.objects["robot"].copy()
    other.rename("twin")
    other.translate(1, 0)
    other.grid[0, 0] = 1
    robot = world.objects["robot"]
    assert (robot.get_name(), robot.get_pos(), robot.grid[0, 0]) == ("robot", (2, 1), 4)
    assert str(other) == "Size (3, 2) object named twin at (3, 1)."


def test_files_come_back(world: EvoWorld, tmp_path: Path) -> None:
    core = World()
    for obj in world.objects.values():
        core.add_object(obj.to_core())
    core.to_json(tmp_path / "world.json")
    again = EvoWorld.from_json(str(tmp_path / "world.json"))
    assert np.array_equal(again.grid, world.grid)
    assert {name: obj.neighbors for name, obj in again.objects.items()} == {
        name: obj.neighbors for name, obj in world.objects.items()
    }
    with pytest.raises(WorldError):
        WorldObject.from_json(str(tmp_path / "world.json"))
    with pytest.raises(FileNotFoundError):
        EvoWorld.from_json(str(tmp_path / "other.json"))
    (tmp_path / "list.json").write_text("[1, 2]")
    with pytest.raises(ValueError):
        EvoWorld.from_json(str(tmp_path / "list.json"))


def test_worlds_are_printed(world: EvoWorld, capsys: pytest.CaptureFixture[str]) -> None:
    world.pretty_print(voxels_per_line=5)
    first, second = capsys.readouterr().out.split("\n\n")[:2]
    assert first.splitlines()[:3] == ["2 | . . H . R", "1 | . . V S S", "0 | F F F F F"]
    assert second.splitlines()[2] == "0 | F F F"


WITHOUT_A_FILE = {"Catcher-v0", "AreaMaximizer-v0", "AreaMinimizer-v0", "WingspanMaximizer-v0", "HeightMaximizer-v0"}


def test_the_benchmarks_worlds_are_there_as_files() -> None:
    folder = Path(BenchmarkBase.DATA_PATH)
    for task in set(task_ids()) - WITHOUT_A_FILE:
        spec = {obj.name: obj for obj in get_task(task).objects}
        world = EvoWorld.from_json(str(folder / f"{task}.json"))
        assert all(obj.to_core() == spec[name] for name, obj in world.objects.items())
        assert set(spec) - set(world.objects) <= {name for name in spec if name.startswith("block_")}
    for name, size in (("package", (3, 2)), ("peg", (5, 1)), ("rigid_2x2", (2, 2)), ("rigid_3x3", (3, 3))):
        obj = WorldObject.from_json(str(folder / f"{name}.json"))
        assert (obj.grid_size.x, obj.grid_size.y) == size
    assert len(EvoWorld.from_json(str(folder / "ShapeChange.json")).objects) == 1


def test_constants() -> None:
    assert evogym.VOXEL_TYPES == {"EMPTY": 0, "RIGID": 1, "SOFT": 2, "H_ACT": 3, "V_ACT": 4, "FIXED": 5}
    assert [released_id(task) for task in task_ids()] == evogym.BASELINE_ENV_NAMES
    assert "WingspanMazimizer-v0" in evogym.BASELINE_ENV_NAMES
    assert evogym.hashable(np.array([[0.0, 3], [5, 1]])) == "0351"


def test_a_star_import_gives_what_the_modules_import() -> None:
    names: dict[str, object] = {}
    exec("from warpvox.evogym import *", names)
    assert names["np"] is np
    assert names["random"] is random
    assert {"EvoWorld", "EvoSim", "EvoViewer", "WorldObject", "Pair", "Timer", "Tuple", "Optional"} <= set(names)


@pytest.mark.parametrize("kind", [RangeError, AssertionError, ValueError])
def test_distributions_are_checked(kind: type[Exception]) -> None:
    for weights in ([], [0, 0], [1, -1]):
        with pytest.raises(kind):
            evogym.draw(np.array(weights))
    with pytest.raises(kind):
        evogym.get_uniform(0)
    with pytest.raises(kind):
        evogym.sample_robot((3, 3), np.ones(4))
    for shape in (5, (5.0, 5), (0, 5), "55"):
        with pytest.raises(kind):
            evogym.sample_robot(shape)


def naive_draw(weights: np.ndarray) -> int:
    """One number of the global generator, compared with the sums of the shares from the first on."""
    place, share = random.uniform(0, 1), 0.0
    for index, weight in enumerate(weights / weights.sum()):
        share += weight
        if place <= share:
            return index
    raise AssertionError


def test_robots_come_from_the_global_generator_cell_by_cell() -> None:
    weights = np.array([0.6, 0.2, 0.2, 0.2, 0.2])
    for seed in range(5):
        random.seed(seed)
        robot, connections = evogym.sample_robot((4, 5))
        after = random.random()
        random.seed(seed)
        while True:
            cells = np.array([naive_draw(weights) for _ in range(20)], float).reshape(4, 5)
            if evogym.is_connected(cells) and evogym.has_actuator(cells):
                break
        assert np.array_equal(robot, cells)
        assert random.random() == after
        assert robot.dtype == float
        assert np.array_equal(connections, evogym.get_full_connectivity(robot))
        check_design(robot)


def test_pairs_are_of_whole_numbers() -> None:
    with pytest.raises(TypeError):
        evogym.Pair(1.5, 2)
    with pytest.raises(ArgumentTypeError):
        evogym.Pair(1, 2) + "3"
    with pytest.raises(IndexError):
        evogym.Pair(1, 2)[2]
    assert evogym.Pair(3, 3) == 3
    assert evogym.Pair(3, 4) != 3


def test_timers_hold_back(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    now = [0.0]
    monkeypatch.setattr("warpvox.evogym.utils.time.monotonic", lambda: now[0])
    timer, free = evogym.Timer(11), evogym.Timer()
    for step in range(1, 11):
        timer.step()
        free.step()
        assert free.should_step()
        assert not timer.should_step()
        now[0] = step / 10 + 1e-6
        assert timer.should_step()
    timer.step(verbose=True)
    assert capsys.readouterr().out == "rps: 11 | avg rps: 11.00\n"
