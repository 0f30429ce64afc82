"""Files from elsewhere: none is unpickled or takes more memory than it has bytes, a damaged one gives one sentence."""

import json
import pickle
import sqlite3
import time
import zipfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from damage import damaged_bytes, damaged_tree, refusals
from refusals import refused
from sample_files import archive_bytes, checkpoint_content, config_text, rollout_bytes, world_tree

import warpvox as wv
from warpvox.algos.archive import Archive
from warpvox.algos.checkpoints.export import read_exported
from warpvox.algos.checkpoints.policy import read_policy
from warpvox.algos.find import find_run
from warpvox.algos.report import family_tree
from warpvox.algos.robots.entry import Robot, read_robot, save_robot
from warpvox.algos.training.pretrained import check_learned
from warpvox.cli.config import load
from warpvox.design import check_design, full_connections, load_design, save_design
from warpvox.errors import ConfigError, DesignError, RolloutError, RunError, WorldError
from warpvox.io.reading import Unreadable, parse_json, parse_yaml, read_facts
from warpvox.io.world_files import LARGEST_GRID
from warpvox.runs import write_summary
from warpvox.view.rollout import Rollout
from warpvox.world import World, WorldObject


@pytest.mark.parametrize("text", ["[" + "[]," * 300_000 + "]", "1:" * 300_000 + "1", "{" + "a: 1," * 100_000 + "}"])
def test_a_configuration_that_would_take_minutes_is_not_read(text: str, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(f"task: Walker-v0\njunk: {text}\n...\n")
    began = time.process_time()
    with refused(RunError, "are the limit"):
        find_run(str(tmp_path), "")
    with refused(ConfigError, "are the limit"):
        load("train", [f"config={tmp_path}"])
    assert time.process_time() - began < 5


@pytest.mark.parametrize("number", ["Infinity", "-Infinity", "NaN", "1e999", "-1e999"])
def test_numbers_that_json_lacks_are_missing_from_facts(number: str, tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text(f'{{"commit": {number}, "more": [{{"x": {number}}}, 2.5]}}')
    assert read_facts(tmp_path / "summary.json") == {"commit": None, "more": [{"x": None}, 2.5]}
    write_summary(tmp_path, {"best_return": float(number), "returns": (float(number), 1.5)})
    found = parse_json((tmp_path / "summary.json").read_text())
    assert (found["best_return"], found["returns"]) == (None, [None, 1.5])


@pytest.mark.parametrize("value", [".inf", "-.inf", ".nan", "2020-01-01"])
def test_facts_that_the_file_of_a_robot_cannot_hold_are_refused(value: str, tmp_path: Path) -> None:
    robot = Robot(
        "Walker-v0", np.array([[3]]), np.zeros((2, 0), int), None, {"config": {"seed": yaml.safe_load(value)}}
    )
    with pytest.raises(RunError):
        save_robot(tmp_path / "a.npz", robot)
    assert not any(tmp_path.iterdir())


class Creates:
    """Pickles itself as a call that makes a file."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple:
        return Path.touch, (self.marker,)


def test_pickles_are_never_run(tmp_path: Path) -> None:
    marker = tmp_path / "marker"
    cells = np.array([[Creates(marker)]], object)
    np.save(tmp_path / "a.npy", cells, allow_pickle=True)
    np.savez(tmp_path / "a.npz", arr_0=cells, header=cells)
    (tmp_path / "b.npy").write_bytes(pickle.dumps(Creates(marker)))
    for name in ("a.npy", "a.npz", "b.npy"):
        with pytest.raises(DesignError):
            load_design(tmp_path / name)
    with pytest.raises(RolloutError):
        Rollout.load(tmp_path / "a.npz")
    with pytest.raises(RunError):
        read_robot(tmp_path / "a.npz")
    torch.save(checkpoint_content() | {"more": Creates(marker)}, tmp_path / "a.pt")
    (tmp_path / "b.pt").write_bytes(pickle.dumps(Creates(marker)))
    for name in ("a.pt", "b.pt"):
        with pytest.raises(RunError):
            read_policy(tmp_path / name)
    (tmp_path / "config.yaml").write_text(f"{config_text()}more: !!python/object/apply:os.mkdir ['{marker}']\n")
    with pytest.raises(RunError):
        find_run(str(tmp_path), "outputs")
    assert not marker.exists()
    pickle.loads(pickle.dumps(Creates(marker)))
    assert marker.exists()  # it would have been made


def test_yaml_is_plain_values() -> None:
    many = [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 30)]
    texts = {"\n".join(["a0: &a0 [x, x]", *many]): "alias", "[" * 5000: "deeply", "a: ${oc.env:HOME}": "reference"}
    for text, words in texts.items():
        with refused(Unreadable, words):
            parse_yaml(text)
    with pytest.raises(ConfigError):
        wv.Training.of({"ppo": {"entropy_coef": 10**400}})


def test_worlds_and_bodies_have_a_size(tmp_path: Path) -> None:
    entry = {"indices": [0], "types": [1], "neighbors": {"0": []}}
    many = {"grid_width": 2000, "grid_height": 1, "objects": {str(k): entry for k in range(1001)}}
    boxes = {str(k): entry | {"indices": [k], "neighbors": {str(k): []}, "box": [0, 0, 900, 900]} for k in range(9)}
    world = World(5, 5)
    for make in (
        lambda: World.from_json({"grid_width": 10**9, "grid_height": 10**9, "objects": {"a": entry}}),
        lambda: World.from_json(many),
        lambda: World.from_json({"grid_width": 900, "grid_height": 900, "objects": boxes}),
        lambda: World(10**12, 10**12),
        lambda: world.add_from_array("a", [[1]], 10**12, 10**12),
        lambda: world.add_object(WorldObject.from_array("a", [[1]], LARGEST_GRID, 2)),
    ):
        with pytest.raises(WorldError):
            make()
    assert (world.width, world.objects) == (5, {})
    rows = [["x" * 1_000_000] + [1] * 10_000]  # numpy would make room for the text in every cell: 40 GB
    (tmp_path / "a.json").write_text(json.dumps({"body": rows}))
    np.savez_compressed(tmp_path / "a.npz", arr_0=np.zeros(10**8, np.int8))
    for make in (
        lambda: check_design(np.full((257, 257), 3)),
        lambda: load_design("random:99999x99999"),
        lambda: load_design(tmp_path / "a.json"),
        lambda: load_design(tmp_path / "a.npz"),
    ):
        with pytest.raises(DesignError):
            make()


GOOD = checkpoint_content()
WEIGHTS = GOOD["actor_state_dict"]
QUANTIZED = torch.quantize_per_tensor(torch.ones(3), 0.1, 0, torch.qint8)


@pytest.mark.parametrize(
    "changes",
    [
        {"policy": None},
        {"policy": [1]},
        {"policy": GOOD["policy"] | {"num_obs": 60_000, "hidden": [60_000, 60_000]}},
        {"policy": GOOD["policy"] | {"num_obs": 10**12}},
        {"policy": GOOD["policy"] | {"hidden": [2**63]}},
        {"policy": GOOD["policy"] | {"hidden": None}},
        {"policy": GOOD["policy"] | {"action_scale": 10**400}},
        {"policy": GOOD["policy"] | {"activation": 3}},
        {"policy": GOOD["policy"] | {"voxels": [3]}},
        {"policy": GOOD["policy"] | {"gait": {"stages": 1}}},
        {"policy": GOOD["policy"] | {"gait": {"stages": 10**9, "rows": 10**9, "columns": 10**9}}},
        {"actor_state_dict": [WEIGHTS]},
        {"actor_state_dict": WEIGHTS | {"mlp.0.weight": torch.ones(1).expand(8, 6)}},
        {"actor_state_dict": WEIGHTS | {"mlp.0.weight": torch.full((8, 6), torch.nan)}},
        {"actor_state_dict": WEIGHTS | {"mlp.0.bias": QUANTIZED}},
        {"actor_state_dict": WEIGHTS | {"mlp.0.weight": torch.ones(8, 6, device="meta")}},
        {"actor_state_dict": WEIGHTS | {"mlp.0.weight": torch.ones(8, 6).to_sparse()}},
    ],
)
def test_a_checkpoint_of_another_kind_is_refused(changes: dict, tmp_path: Path) -> None:
    torch.save(GOOD | changes, tmp_path / "a.pt")
    with pytest.raises(RunError):
        read_policy(tmp_path / "a.pt")
    with pytest.raises(RunError):
        wv.load_policy(tmp_path / "a.pt")


def test_a_value_function_of_another_kind_is_refused(tmp_path: Path) -> None:
    torch.save(GOOD, tmp_path / "a.pt")
    for value in (torch.ones(2, device="meta"), QUANTIZED, 3):
        content = GOOD | {"critic_state_dict": {"w": value}, "optimizer_state_dict": {}}
        with pytest.raises(RunError):
            check_learned(tmp_path / "a.pt", content, None)


def test_an_encrypted_export_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "policy.pt"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("policy/extra/warpvox.pt", "{}")
    data = bytearray(path.read_bytes())
    data[data.index(b"PK\x01\x02") + 8] |= 1
    data[6] |= 1
    path.write_bytes(data)
    with pytest.raises(RunError):
        read_exported(path)


def stored(path: Path, **changes: Any) -> Path:
    """A robot with a network, other values in its header or arrays, and the right checksum."""
    robot = wv.zoo("BridgeWalker-v0")
    policy = robot.policy
    object.__setattr__(policy, "scale", changes.pop("scale", policy.scale))
    robot = Robot(robot.task, robot.body, changes.pop("connections", robot.connections), policy, robot.about | changes)
    return save_robot(path, robot)


@pytest.mark.parametrize(
    "changes",
    [
        {"connections": np.zeros(4, np.int32)},
        {"connections": np.zeros((2, 2, 2), np.int32)},
        {"connections": np.full((2, 1), 999, np.int32)},
        {"lengths": "zz"},
        {"return": [[1]]},
    ],
)
def test_a_robot_of_another_kind_is_refused(changes: dict, tmp_path: Path) -> None:
    with pytest.raises(RunError):
        read_robot(stored(tmp_path / "robot.npz", **changes))


def test_a_robot_with_a_number_that_no_float_can_hold_is_refused(tmp_path: Path) -> None:
    with np.load(stored(tmp_path / "robot.npz")) as archive:
        arrays = dict(archive)
    header = json.loads(arrays["header"].tobytes())
    header["network"]["scale"] = 10**400
    np.savez(tmp_path / "robot.npz", **arrays | {"header": np.frombuffer(json.dumps(header).encode(), np.uint8)})
    with pytest.raises(RunError):
        read_robot(tmp_path / "robot.npz")


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE candidates SET fitness = 'x'",
        "UPDATE candidates SET fitness = 9e999",
        "UPDATE candidates SET fitness = NULL WHERE stopped = 0",
        "UPDATE candidates SET policy = '../../x'",
        "UPDATE candidates SET body = '[[[1]]]'",
        "UPDATE candidates SET body = zeroblob(9)",
        f"UPDATE candidates SET body = '{'[' * 5000}'",
        "UPDATE curves SET value = 'x'",
        "UPDATE parents SET parent = 99",
        "DROP TABLE curves",
        "DROP VIEW generations",
    ],
)
def test_a_damaged_archive_is_refused(tmp_path: Path, change: str) -> None:
    path = tmp_path / "archive.sqlite"
    path.write_bytes(archive_bytes())
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        db.execute(change)
    with pytest.raises(RunError), Archive.read(path) as archive:
        archive.records()


def test_what_an_archive_says_is_text_in_a_report(tmp_path: Path) -> None:
    path = tmp_path / "archive.sqlite"
    path.write_bytes(archive_bytes())
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        db.execute("UPDATE candidates SET origin = '</title></svg><script>alert(1)</script>'")
    with Archive.read(path) as archive:
        assert "<script" not in family_tree(archive.records())


def use_archive(path: Path) -> None:
    with Archive.read(path) as archive:
        archive.records()


def use_config(path: Path) -> None:
    load("train", [f"config={find_run(str(path.parent), 'outputs').folder}"])


def npz(path: Path) -> bytes:
    body = wv.example_design("walker")
    return save_robot(path, Robot("Walker-v0", body, full_connections(body).T, None)).read_bytes()


READERS: dict[str, tuple[Callable[[Path], bytes], Callable[[Path], object]]] = {
    "world.json": (lambda _: json.dumps(world_tree()).encode(), World.from_json),
    "design.json": (lambda _: b'{"body": [[3, 3], [4, 0]]}', load_design),
    "design.npz": (lambda path: save_design(path, wv.example_design("walker")).read_bytes(), load_design),
    "design.npy": (lambda path: save_design(path, wv.example_design("walker")).read_bytes(), load_design),
    "robot.npz": (npz, read_robot),
    "rollout.npz": (lambda _: rollout_bytes(), Rollout.load),
    "model_1.pt": (lambda path: torch.save(GOOD, path) or path.read_bytes(), read_policy),
    "archive.sqlite": (lambda _: archive_bytes(), use_archive),
    "config.yaml": (lambda _: config_text().encode(), use_config),
}


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_are_refused_by_a_sentence_or_of_use(name: str, tmp_path: Path) -> None:
    make, read = READERS[name]
    path = tmp_path / name
    whole = make(path)

    def use(data: bytes) -> None:
        path.write_bytes(data)
        read(path)

    use(whole)
    assert refusals(use, damaged_bytes(whole, 60)) > 9
    if path.suffix in (".json", ".yaml"):
        trees = damaged_tree(yaml.safe_load(whole), 60)
        assert refusals(use, (json.dumps(tree).encode() for tree in trees)) > 9
