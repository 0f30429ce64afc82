"""The drop-in's simulation: its record of the past, several robots, moved objects, errors."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from warpvox.errors import SimulationError
from warpvox.evogym import EvoSim, EvoWorld
from warpvox.evogym.engine import Engine
from warpvox.evogym.simulator_cpp import Sim
from warpvox.world import World

BODY = np.array([[3, 1, 3], [4, 2, 4], [4, 0, 4]])


def make_world(second: bool = False) -> EvoWorld:
    world = EvoWorld()
    world.add_from_array("ground", np.full((1, 30), 5), 0, 0)
    world.add_from_array("robot", BODY, 3, 1)
    if second:
        world.add_from_array("other", np.array([[3, 4]]), 10, 1)
    world.add_from_array("box", np.full((2, 2), 2), 15, 1)
    return world


def waves(steps: int, count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.6, 1.6, (steps, count))


def test_objects_and_points_have_an_order() -> None:
    sim = EvoSim(make_world(second=True))
    every = sim.pos_at_time(0)
    parts = [sim.object_pos_at_time(0, name) for name in ("other", "robot", "box", "ground")]
    assert np.array_equal(every, np.concatenate(parts, axis=1))
    assert parts[0].T.tolist() == pytest.approx(np.array([[10, 2], [11, 2], [10, 1], [11, 1], [12, 2], [12, 1]]))
    assert all(points.flags.f_contiguous for points in parts)  # sums over points then run as in the release
    assert np.array_equal(sim.vel_at_time(0), np.zeros_like(every))


def test_actuators_are_counted_row_by_row() -> None:
    sim = EvoSim(make_world())
    assert sim.get_actuator_indices("robot").tolist() == [0, 2, 3, 5, 6, 8]
    assert sim.get_indices_of_actuators("robot").shape == (1, 6)
    assert sim.get_dim_action_space("robot") == 6


def test_what_the_simulation_has_derived_is_never_stale() -> None:
    world = World()
    for obj in make_world().objects.values():
        world.add_object(obj.to_core())
    engine = Engine(world)

    def agree() -> bool:
        now = engine.positions(engine.time, "robot").sum(0) / len(engine.positions(engine.time, "robot"))
        return np.array_equal(engine._sim.com("robot")[0].numpy(), now)

    assert agree()
    for row in waves(3, 6):
        engine.goals["robot"][:] = row
        engine.step()
        assert agree()
    engine.translate("robot", 0.5, 0.0)
    assert agree()
    engine.revert(1)
    assert agree()


def test_robots_have_actions_of_their_own() -> None:
    apart, together = EvoSim(make_world()), EvoSim(make_world(second=True))
    for row in waves(30, 6):
        apart.set_action("robot", row)
        together.set_action("robot", row)
        together.set_action("other", [0.8, 1.3])
        apart.step()
        together.step()
    assert np.array_equal(apart.object_pos_at_time(30, "robot"), together.object_pos_at_time(30, "robot"))
    width = np.ptp(together.object_pos_at_time(30, "other")[0])
    assert width < 1.9


def test_actions_hold_until_others_are_set_and_are_not_clipped() -> None:
    world = EvoWorld()
    world.add_from_array("robot", np.array([[3]]), 0, 5)
    lengths = {}
    for goal in (1.0, 1.2, 1.6, 2.0):
        sim = EvoSim(world)
        if goal != 1.0:
            sim.set_action("robot", np.array([goal]))
        sim.step()
        sim.step()
        lengths[goal] = np.ptp(sim.object_pos_at_time(2, "robot")[0])
    assert lengths[1.0] == pytest.approx(1.0, abs=1e-6)
    assert lengths[1.0] < lengths[1.2] < lengths[1.6] < lengths[2.0]


def test_the_past_is_remembered_and_can_be_returned_to() -> None:
    sim, actions = EvoSim(make_world()), waves(20, 6)
    seen = [sim.pos_at_time(0)]
    for row in actions:
        sim.set_action("robot", row)
        sim.step()
        seen.append(sim.pos_at_time(sim.get_time()))
    assert sim.get_time() == 20
    assert all(np.array_equal(sim.pos_at_time(time), points) for time, points in enumerate(seen))
    sim.revert(12)
    assert sim.get_time() == 12
    assert np.array_equal(sim.pos_at_time(12), seen[12])
    with pytest.raises(ValueError):
        sim.pos_at_time(13)
    for row in actions[12:]:
        sim.set_action("robot", row)
        sim.step()
    # Not bit for bit: the release, too, takes velocities for those of the last sub-step when it goes back.
    assert np.abs(sim.pos_at_time(20) - seen[20]).max() < 0.05
    sim.reset()
    for row in actions:
        sim.set_action("robot", row)
        sim.step()
    assert np.array_equal(sim.pos_at_time(20), seen[20])


def test_what_is_returned_is_a_copy() -> None:
    sim = EvoSim(make_world())
    for points in (sim.object_pos_at_time(0, "robot"), Sim.object_pos_at_time(sim, 0, "ground")):
        points += 1
    assert np.array_equal(sim.object_pos_at_time(0, "robot"), EvoSim(make_world()).object_pos_at_time(0, "robot"))
    assert sim.object_pos_at_time(0, "ground").max() == pytest.approx(30)


@pytest.mark.parametrize("name", ["box", "ground", "shelf"])
def test_objects_can_be_translated(name: str) -> None:
    world = make_world()
    world.add_from_array("shelf", np.array([[5, 2]]), 20, 5)
    sim = EvoSim(world)
    for row in waves(5, 6):
        sim.set_action("robot", row)
        sim.step()
    before = {each: sim.object_pos_at_time(5, each) for each in ("robot", "box", "ground", "shelf")}
    early = sim.pos_at_time(2)
    sim.translate_object(0.3, 0.0, name)
    for each, points in before.items():
        shift = [[3.0], [0.0]] if each == name else 0.0
        assert np.allclose(sim.object_pos_at_time(5, each), points + shift, atol=1e-12, rtol=0)
    assert np.array_equal(sim.pos_at_time(2), early)
    assert sim.step() is False
    moved = np.abs(sim.object_pos_at_time(6, "robot") - before["robot"]).max()
    assert 0 < moved < 0.5


@pytest.mark.parametrize(
    ("name", "move", "turn"),  # as the release gives them: rounding decides
    [
        ("robot", (0.02, 0.1), 0.0020562779859526034),
        ("box", (0.05, 0.3), 0.0013098655586423161),
        ("ground", (0.0, -0.1), 0.001042900917955862),
    ],
)
def test_turns_are_measured_from_where_an_object_was_moved_at_time_0(name: str, move: tuple, turn: float) -> None:
    world = EvoWorld()
    world.add_from_array("ground", np.full((1, 12), 5), 0, 0)
    world.add_from_array("robot", np.array([[3, 3, 3], [4, 0, 4]]), 1, 1)
    world.add_from_array("box", np.full((2, 2), 2), 6, 1)
    sim = EvoSim(world)
    sim.translate_object(*move, name)
    sim.step()
    assert sim.object_orientation_at_time(0, name) == pytest.approx(turn, abs=1e-15)


def test_translated_terrain_carries() -> None:
    world = EvoWorld()
    world.add_from_array("robot", np.array([[3]]), 10, 2)
    world.add_from_array("table", np.array([[5, 5], [2, 5]]), 0, 0)
    sim = EvoSim(world)
    sim.translate_object(0.95, -0.05, "table")
    for _ in range(60):
        sim.step()
    assert sim.object_pos_at_time(60, "robot")[1].min() == pytest.approx(1.5, abs=0.05)


def test_the_turn_of_a_body_with_a_point_at_its_centre_is_that_of_the_release() -> None:
    world = EvoWorld()
    world.add_from_array("robot", np.array([[1, 1], [1, 3]]), 0, 5)
    sim = EvoSim(world)
    sim.set_action("robot", np.array([1.4]))
    sim.step()
    sim.step()
    assert sim.object_orientation_at_time(2, "robot") == pytest.approx(0.023177012588260423, abs=1e-15)


def test_a_robot_that_folds_stops_the_clock() -> None:
    body = np.array([[3, 3, 1, 2, 0], [4, 0, 0, 2, 4], [4, 2, 0, 3, 1], [3, 2, 0, 2, 1], [4, 3, 3, 2, 0]])
    world = EvoWorld()
    world.add_from_array("ground", np.full((1, 20), 5), 0, 0)
    world.add_from_array("robot", body, 3, 1)
    sim = EvoSim(world)
    rng = np.random.default_rng(3)
    for _ in range(600):
        sim.set_action("robot", np.where(rng.random(sim.get_dim_action_space("robot")) < 0.5, 0.0, 4.0))
        time = sim.get_time()
        if sim.step():
            assert sim.get_time() == time
            return
        assert sim.get_time() == time + 1
    pytest.fail("goals far beyond what bodies survive have not folded this one")


def test_orientation_of_the_past_is_that_of_its_time() -> None:
    sim, found = EvoSim(make_world()), []
    sim.get_time()
    for row in waves(5, 6):
        found.append(sim.object_orientation_at_time(sim.get_time(), "robot"))
        sim.set_action("robot", row)
        sim.step()
    points = sim.pos_at_time(5)
    assert [sim.object_orientation_at_time(time, "robot") for time in range(5)] == found
    assert len(set(found)) == 5
    assert np.array_equal(sim.pos_at_time(5), points)  # asking has moved nothing
    assert sim.object_orientation_at_time(5, "ground") == sim.object_orientation_at_time(0, "ground") < 5e-3


@pytest.mark.parametrize(
    ("ask", "kind", "words"),
    [
        (lambda sim: sim.object_pos_at_time(0, "stone"), ValueError, "objects are box, ground, robot"),
        (lambda sim: sim.object_vel_at_time(-1, "robot"), ValueError, "between 0 and 0"),
        (lambda sim: sim.object_orientation_at_time(1.0, "robot"), TypeError, "integer"),
        (lambda sim: sim.get_dim_action_space("stone"), ValueError, "not a valid robot name"),
        (lambda sim: sim.get_dim_action_space("box"), ValueError, "robots are robot. It has no actuator"),
        (lambda sim: sim.object_vel_at_time(0, "robt"), ValueError, "Did you mean 'robot'"),
        (lambda sim: sim.object_pos_at_time(0, ["robot"]), ValueError, "objects are box, ground, robot"),
        (lambda sim: sim.object_orientation_at_time(0, None), ValueError, "None is not a valid object name"),
        (lambda sim: sim.translate_object(1, 0, None), ValueError, "None is not a valid object name"),
        (lambda sim: sim.revert(3), ValueError, "between 0 and 0, got 3"),
        (lambda sim: Sim.set_action(sim, "robot", [[1, 1.0]]), ValueError, "no actuator at index 1"),
        (lambda _: EvoSim("world.json"), TypeError, "got 'world.json'; EvoWorld.from_json(FILE)"),
    ],
)
def test_mistakes_are_explained(ask, kind: type[Exception], words: str) -> None:
    with refused(kind, words):
        ask(EvoSim(make_world()))


def test_the_lower_layer_reads_objects_and_files(tmp_path: Path) -> None:
    sim = Sim()
    sim.init(30, 10)
    none = np.empty((2, 0))
    assert sim.read_object_from_array(np.full((1, 3), 5), none, "ground", 0, 0)
    (tmp_path / "robot.txt").write_text("2 1\n3 4\n0 1\n")
    assert sim.read_robot_from_file(str(tmp_path / "robot.txt"), "robot", 0, 1)
    assert sim.get_indices_of_actuators("robot").tolist() == [[0, 1]]
    sim.set_action("robot", np.array([[1, 1.4]]))
    assert sim.step() is False
    assert sim.object_pos_at_time(1, "robot").shape == (2, 6)
    assert sim.pos_at_time(0)[:, 0].tolist() == pytest.approx([0, 0.2])
    with pytest.raises(SimulationError):
        sim.read_object_from_array(np.full((1, 1), 1), none, "late", 5, 5)


def test_an_empty_world_is_refused_and_still_ones_are_not() -> None:
    with pytest.raises(SimulationError):
        EvoSim(EvoWorld()).step()
    still = EvoWorld()
    still.add_from_array("ground", np.full((1, 4), 5), 0, 0)
    sim = EvoSim(still)
    sim.step()
    assert np.array_equal(sim.pos_at_time(1), sim.pos_at_time(0))


def test_a_history_of_some_steps_is_kept_if_asked_for() -> None:
    sim, whole = EvoSim(make_world()), EvoSim(make_world())
    sim.history = 3
    for row in waves(8, 6):
        for each in (sim, whole):
            each.set_action("robot", row)
            each.step()
    for time in (0, 6, 7, 8):
        assert np.array_equal(sim.pos_at_time(time), whole.pos_at_time(time))
        assert np.array_equal(sim.vel_at_time(time), whole.vel_at_time(time))
    for time in (1, 5):
        with pytest.raises(ValueError):
            sim.pos_at_time(time)
        with pytest.raises(ValueError):
            sim.revert(time)
    sim.history = 1
    sim.step()
    whole.step()
    for each in (sim, whole):
        each.translate_object(0.5, 1.0, "box")
        each.translate_object(1.0, 0.0, "ground")
        each.step()
    assert np.array_equal(sim.pos_at_time(10), whole.pos_at_time(10))
    sim.reset()
    assert np.array_equal(sim.pos_at_time(0), whole.pos_at_time(0))
    sim.history = None
    for _ in range(3):
        sim.step()
    assert [len(sim.pos_at_time(time)) for time in range(4)] == [2, 2, 2, 2]
    for wrong in (0, -1, 1.5, "3"):
        sim.history = wrong
        with pytest.raises(ValueError):
            sim.step()
    assert sim.get_time() == 3


def test_the_history_of_all_simulations_is_limited_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(EvoSim, "history", 1)
    sim = EvoSim(make_world())
    sim.step()
    tracemalloc.start()
    before, _ = tracemalloc.get_traced_memory()
    for _ in range(50):
        sim.step()
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after - before < 10 * sim.pos_at_time(0).nbytes  # a step has twice that, positions and velocities
