"""What fuzzing has found once, at its smallest: each was another error, a wait or a wrong answer."""

from __future__ import annotations

import json
import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from fuzz_arguments import Stranger
from fuzz_files import archive_bytes

import warpvox
from warpvox.algos.codesign.archive import Archive
from warpvox.cli.config import load, load_values
from warpvox.design import check_design, load_design, sample_design
from warpvox.editor.documents import check_file_name
from warpvox.editor.server import EditorServer
from warpvox.envs.gym import VoxelEnv
from warpvox.envs.registry import get_task
from warpvox.errors import ActionError, ConfigError, DesignError, RunError, SimulationError, TaskError, WorldError
from warpvox.evogym.simulator_cpp import Sim
from warpvox.simulation import Simulation
from warpvox.view.rollout import Rollout
from warpvox.world import World, WorldObject

SMALL = {"device": "cpu", "threads": 1}
ROBOT = np.array([[3, 4]], np.int8)


@pytest.fixture
def world() -> World:
    made = World(5, 5)
    made.add_from_array("robot", ROBOT, 1, 1)
    return made


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("x" * 5000 + ".npy", "cannot be read"),
        ("a\0b.npz", "design"),
        ("random:" + "9" * 5000 + "x1", "Cannot read the size"),
        ("random:100000x100000", "too large"),
        ("/dev/zero.npy", "no design file"),
        (Stranger(), "cannot be read as an array"),
        ([["3", 4]], "must hold numbers"),
        ([[[3], 4]], "two dimensions"),
    ],
)
def test_designs(given: object, words: str) -> None:
    with pytest.raises(DesignError, match=words):
        load_design(given)


def test_connections_of_a_structure_file_are_pairs(tmp_path: Path) -> None:
    for pairs in ([[0.0, np.nan]], [[0], [np.nan]], [0, 1], [[[0], [1]]]):
        np.savez(tmp_path / "a.npz", arr_0=ROBOT, arr_1=np.array(pairs))
        with pytest.raises(DesignError, match="not pairs of cells"):
            load_design(tmp_path / "a.npz")


@pytest.mark.parametrize(
    "weights", [[1, "x", 1, 1, 1], [1, 1e308, 1e308, 1e308, 1], [1, 1, 1, 1e-9, 0], Stranger(), "walker"]
)
def test_weights_without_a_chance(weights: object) -> None:
    with pytest.raises(DesignError, match=r"must (be|leave)"):
        sample_design((3, 3), 0, weights)
    with pytest.raises(DesignError, match="shape"):
        sample_design((1, float("inf")))


def test_names_and_places_of_objects(world: World) -> None:
    for name in ([], {}, 5, "rob"):
        with pytest.raises(WorldError, match="no object"):
            world.remove_object(name)
        with pytest.raises(WorldError, match="no object"):
            world.move_object(name, 0, 0)
    with pytest.raises(WorldError, match="half of a character"):
        world.add_from_array("\ud800", ROBOT, 0, 3)
    with pytest.raises(WorldError, match="ragged"):
        WorldObject.from_array("a", ROBOT, 0, 0, [[0], [1, 2]])


def test_names_in_files_can_be_written(tmp_path: Path, world: World) -> None:
    text = world.to_json().replace('"robot"', r'"\udfff"')
    with pytest.raises(WorldError, match="half of a character"):
        World.from_json(text)


@pytest.mark.parametrize(
    "data", [b"\x80", b"2 1 3 99999999999999999999999", b"-1 -1 3", b"99999999999999999999 1 3", b"2"]
)
def test_objects_of_the_drop_in(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "object.txt").write_bytes(data)
    with pytest.raises(WorldError):
        Sim().read_object_from_file(str(tmp_path / "object.txt"), "thing", 0, 0)
    with pytest.raises(FileNotFoundError):
        Sim().read_object_from_file(str(tmp_path / "nowhere.txt"), "thing", 0, 0)


@pytest.mark.parametrize("value", [1.7, "1", True, -1, 2**40])
@pytest.mark.parametrize("key", ["x", "y", "first_point", "num_points"])
def test_numbers_of_a_scene_are_not_rounded(tmp_path: Path, key: str, value: object) -> None:
    from fuzz_files import rollout_bytes
    from fuzz_mutate import npy_bytes, unzip, zip_bytes

    parts = unzip(rollout_bytes()[0])
    (tmp_path / "header.npy").write_bytes(parts["header.npy"])
    header = json.loads(np.load(tmp_path / "header.npy").tobytes())
    header["scenes"][0]["objects"][0][key] = value
    parts["header.npy"] = npy_bytes(np.frombuffer(json.dumps(header).encode(), np.uint8))
    (tmp_path / "r.npz").write_bytes(zip_bytes(parts))
    with pytest.raises(warpvox.errors.RolloutError, match="expected a whole number"):
        Rollout.load(tmp_path / "r.npz")


@pytest.mark.parametrize(
    ("words", "error"),
    [
        ({"physics": []}, ConfigError),
        ({"physics": ROBOT}, ConfigError),
        ({"rules": ROBOT}, ConfigError),
        ({"dtype": []}, SimulationError),
        ({"obs": ROBOT}, ConfigError),
        ({"connections": 5}, ConfigError),
        ({"seed": -1}, ConfigError),
        ({"seed": 1.5}, ConfigError),
        ({"seed": "x"}, ConfigError),
        ({"lanes": []}, SimulationError),
        ({"threads": True}, SimulationError),
        ({"device": "cuda:²"}, warpvox.errors.DeviceError),
        ({"designs": Stranger()}, DesignError),
        ({"num_envs": float("nan")}, ConfigError),
    ],
)
def test_make_vec(words: dict, error: type[Exception]) -> None:
    with pytest.raises(error):
        warpvox.make_vec(**{"task": "Walker-v0", "designs": "mini", **SMALL, **words})


def test_simulations(world: World) -> None:
    for words in ({"worlds": 1}, {"loose": 5}, {"loose": "robot"}, {"action_range": 3}, {"action_range": (2, 1)}):
        with pytest.raises(SimulationError):
            Simulation(**{"worlds": [world], **SMALL, **words})


def test_actions(world: World) -> None:
    sim = Simulation([world], **SMALL)
    env = VoxelEnv("Walker-v0", "mini", dtype="float32")
    env.reset(seed=0)
    good = torch.ones(sim.num_envs, sim.num_actions)
    before = sim.state()
    for actions in (
        good.to("meta"),
        good.to_sparse(),
        good.bool(),
        good.to(torch.complex64),
        object,
        Stranger(),
        [["x", 1]],
    ):
        with pytest.raises(ActionError):
            sim.step(actions)
    assert all(torch.equal(sim.state()[name], value) for name, value in before.items())
    for actions in (object, Stranger(), [1.0, [2.0]], "x", good):
        with pytest.raises(ActionError):
            env.step(actions)


@pytest.mark.parametrize(
    "line", ["raise SystemExit(3)", "MINE = replace(MINE, objects=3)", "MINE = replace(MINE, objects=(3,))"]
)
def test_files_of_tasks(tmp_path: Path, line: str) -> None:
    from fuzz_arguments import TASK

    path = tmp_path / "task.py"
    path.write_text(TASK + line + "\n")
    with pytest.raises(TaskError, match=r"cannot be imported|must be"):
        get_task(f"{path}:MINE")


@pytest.mark.parametrize("value", ["1" * 5000, "[" * 3000, "'", "{a:"])
def test_values_on_the_command_line(value: str) -> None:
    with pytest.raises(ConfigError, match="is not KEY=VALUE"):
        load("play", [f"record={value}"])


def test_numbers_that_no_float_can_hold() -> None:
    with pytest.raises(ConfigError, match="a number"):
        load("train", [f"ppo.entropy_coef={'9' * 400}"])
    with pytest.raises(ConfigError, match="stored configuration is not valid"):
        load_values("train", {"ppo": {"entropy_coef": 10**400}})


def test_a_schema_that_is_no_text(tmp_path: Path) -> None:
    """SQLite's complaint repeats the damaged bytes, which Python then cannot decode."""
    data = archive_bytes()
    for word in (b"CREATE TABLE curves", b"candidate INTEGER NOT NULL", b"CREATE VIEW generations"):
        assert word in data
        (tmp_path / "archive.sqlite").write_bytes(data.replace(word, word[:3] + b"\xce" + word[4:]))
        with pytest.raises(RunError, match="damaged"):
            Archive.read(tmp_path / "archive.sqlite")


# ------------------------------------------------------------------------------------------------------ editor


@pytest.fixture
def server(tmp_path: Path) -> Iterator[EditorServer]:
    made = EditorServer(tmp_path)
    made.failures = []

    def note(request: object, address: object) -> None:
        error = sys.exc_info()[1]
        if not isinstance(error, ConnectionError):  # a test may have left before the end of the answer
            made.failures.append(error)

    made.handle_error = note
    threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
    yield made
    made.shutdown()
    made.server_close()


@pytest.mark.parametrize(
    ("length", "body", "status"),
    [
        ("²", b"{}", 411),
        ("9" * 5000, b"{}", 413),
        ("12", rb'{"a":"\ud800"}', 400),
        ("2", b"\xff\xfe", 400),
        ("100001", b"[" * 100_001, 400),
        ("13", b'{"a":1,"a":2}', 400),
    ],
)
def test_requests(server: EditorServer, length: str, body: bytes, status: int) -> None:
    head = (
        f"POST /{server.token}/check HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nContent-Type: application/json\r\n"
        f"Content-Length: {length}\r\n\r\n"
    )
    with socket.create_connection(("127.0.0.1", server.port), timeout=30) as line:
        line.sendall(head.encode("latin-1") + body)
        assert line.recv(12) == f"HTTP/1.1 {status}".encode()
    assert server.failures == []


def test_names_of_files_fit_the_file_system() -> None:
    assert check_file_name("a" * 64) == "a" * 64 + ".json"
    with pytest.raises(WorldError):
        check_file_name("a" + "𠀀" * 63)


def test_a_body_of_texts_is_refused_before_numpy_sees_it() -> None:
    with pytest.raises(DesignError, match="must hold numbers"):
        check_design(["x" * 100, 1])
