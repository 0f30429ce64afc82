"""Reading a file never runs code that is in it, and takes no memory for what the file only claims to hold."""

from __future__ import annotations

import ast
import json
import pickle
import sqlite3
import zipfile
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import torch
from bounds import bounded, refused
from damage import CLAIMS, claiming, npy, unzipped, zipped
from sample_files import SCHEMES, archive_bytes, checkpoint_content, config_text, rollout_bytes

from warpvox.algos.checkpoints.files import load_controller
from warpvox.algos.codesign.archive import Archive
from warpvox.cli.plain_yaml import parse_yaml
from warpvox.cli.runs import find_run
from warpvox.design import LARGEST_BODY, check_design, load_design
from warpvox.editor.documents import read_file
from warpvox.errors import DesignError, RolloutError, RunError, WorldError
from warpvox.io.reading import Unreadable
from warpvox.view.rollout import Rollout
from warpvox.world import LARGEST_GRID, World, WorldObject


class Creates:
    """Pickles itself as a call that makes a file."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple:
        return Path.touch, (self.marker,)


# ---------------------------------------------------------------------------------------------------- no code


def test_a_marker_is_made_where_pickles_are_trusted(tmp_path: Path) -> None:
    """The proof that the hostile files of the tests below would do harm."""
    pickle.loads(pickle.dumps(Creates(tmp_path / "marker")))
    assert (tmp_path / "marker").exists()


def test_pickles_are_never_run(tmp_path: Path) -> None:
    marker = tmp_path / "marker"
    cells = np.array([[Creates(marker)]], object)
    np.save(tmp_path / "a.npy", cells, allow_pickle=True)
    np.savez(tmp_path / "a.npz", arr_0=cells)
    np.savez(tmp_path / "b.npz", arr_0=[[3]], arr_1=cells)
    (tmp_path / "c.npy").write_bytes(pickle.dumps(Creates(marker)))
    for name in ("a.npy", "a.npz", "b.npz", "c.npy"):
        refused(lambda name=name: load_design(tmp_path / name), DesignError, "cannot be read")
    for name in ("a.npz", "c.npy"):
        refused(lambda name=name: Rollout.load(tmp_path / name), RolloutError, r"rollout")
    parts = unzipped(rollout_bytes())
    for name in parts:
        (tmp_path / "r.npz").write_bytes(zipped(parts | {name: npy(cells)}))
        refused(lambda: Rollout.load(tmp_path / "r.npz"), RolloutError, "not made of plain numbers")
    hostile = checkpoint_content() | {"more": Creates(marker)}
    torch.save(hostile, tmp_path / "new.pt")
    torch.save(hostile, tmp_path / "old.pt", _use_new_zipfile_serialization=False)
    (tmp_path / "bare.pt").write_bytes(pickle.dumps(hostile["more"]))
    for name in ("new.pt", "old.pt", "bare.pt"):
        refused(lambda name=name: load_controller(tmp_path / name), RunError, "not a readable checkpoint")
    assert not marker.exists()


@pytest.mark.parametrize(
    "tag", ["object/apply:os.mkdir", "object/new:os.mkdir", "object:pathlib.Path", "name:os.mkdir"]
)
def test_tags_of_yaml_make_nothing(tmp_path: Path, tag: str) -> None:
    marker = tmp_path / "marker"
    (tmp_path / "config.yaml").write_text(config_text() + f"extra: !!python/{tag} ['{marker}']\n")
    refused(lambda: find_run(str(tmp_path), "outputs"), RunError, "cannot be read as YAML")
    assert not marker.exists()


FORBIDDEN = {
    "eval": "runs text",
    "exec": "runs text",
    "pickle.load": "runs what the file says",
    "pickle.loads": "runs what the file says",
    "pickle.Unpickler": "runs what the file says",
    "marshal.loads": "reads code",
    "yaml.unsafe_load": "makes any object",
    "yaml.full_load": "makes objects",
    "np.load": "of warpvox.io.reading, which checks sizes first",
    "numpy.load": "of warpvox.io.reading, which checks sizes first",
    "os.system": "runs a shell",
}


def calls_of(tree: ast.AST) -> list[tuple[ast.Call, str]]:
    return [(node, ast.unparse(node.func)) for node in ast.walk(tree) if isinstance(node, ast.Call)]


def offences(source: str) -> list[str]:
    """Calls in a source that could run what a file says."""
    found = []
    for call, name in calls_of(ast.parse(source)):
        words = {keyword.arg: ast.unparse(keyword.value) for keyword in call.keywords}
        wrong = name in FORBIDDEN
        wrong |= name == "torch.load" and words.get("weights_only") != "True"
        wrong |= name == "yaml.load" and not words.get("Loader", "").endswith(("SafeLoader", "_PlainLoader"))
        wrong |= words.get("allow_pickle") == "True" or words.get("shell") == "True"
        found += [f"line {call.lineno}: {name}"] if wrong else []
    return found


def test_the_package_has_no_call_that_runs_a_file(repository: Path) -> None:
    for folder in ("warpvox", "kernels", "envs", "algos", "configs"):
        for path in (repository / folder).rglob("*.py"):
            assert offences(path.read_text(encoding="utf-8")) == [], path


@pytest.mark.parametrize(
    "source",
    [
        *(
            "eval('1')",
            "torch.load(f)",
            "torch.load(f, weights_only=False)",
            "np.load(f, allow_pickle=True)",
            "np.load(f)",
        ),
        *("yaml.load(f, Loader=yaml.Loader)", "yaml.load(f)", "pickle.load(f)", "run(f, shell=True)"),
    ],
)
def test_the_search_for_such_calls_finds_them(source: str) -> None:
    assert offences(source)


# --------------------------------------------------------------------------------------------- sizes and claims


@pytest.mark.parametrize("data", CLAIMS)
def test_arrays_are_as_large_as_they_claim(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.npy").write_bytes(data)
    refused(lambda: load_design(tmp_path / "a.npy"), DesignError, "cannot be read")
    for name in ("arr_0.npy", "arr_1.npy"):
        (tmp_path / "a.npz").write_bytes(zipped({"arr_0.npy": npy(np.array([[3]]))} | {name: data}))
        refused(lambda: load_design(tmp_path / "a.npz"), DesignError, "cannot be read")
    (tmp_path / "r.npz").write_bytes(zipped(unzipped(rollout_bytes()) | {"positions.npy": data}))
    refused(lambda: Rollout.load(tmp_path / "r.npz"), RolloutError, "damaged")


def test_a_bomb_is_not_unpacked(tmp_path: Path) -> None:
    """100 kB that stand for 100 MB: more than a design may have, and seen before any of it is unpacked."""
    size = 100_000_000
    with (
        zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("arr_0.npy", "w") as file,
    ):
        file.write(claiming(f"({size},)", descr="'|i1'"))
        for _ in range(size // 10_000_000):
            file.write(bytes(10_000_000))
    assert (tmp_path / "a.npz").stat().st_size < 200_000
    refused(lambda: load_design(tmp_path / "a.npz"), DesignError, "are the limit")


def test_worlds_and_bodies_have_a_size(tmp_path: Path) -> None:
    entry = {"indices": [0], "types": [1], "neighbors": {"0": []}}
    huge = {"grid_width": 10**9, "grid_height": 10**9, "objects": {"a": entry}}
    refused(lambda: World.from_json(huge), WorldError, "are the limit")
    refused(lambda: World(10**12, 10**12), WorldError, "are the limit")
    world = World(5, 5)
    for change in (
        lambda: world.add_from_array("a", [[1]], 10**12, 10**12),
        lambda: world.add_object(WorldObject.from_array("a", [[1]], LARGEST_GRID, 2)),
    ):
        refused(change, WorldError, "are the limit")
    assert (world.width, world.objects) == (5, {})
    many = {"grid_width": 2000, "grid_height": 1, "objects": {str(k): entry for k in range(1001)}}
    refused(lambda: World.from_json(many), WorldError, "1000 are the limit")
    boxes = {
        str(k): {"indices": [k], "types": [1], "neighbors": {str(k): []}, "box": [0, 0, 900, 900]} for k in range(9)
    }
    wide = {"grid_width": 900, "grid_height": 900, "objects": boxes}
    refused(lambda: World.from_json(wide), WorldError, "more than 2,000,000 cells")
    side = int(LARGEST_BODY**0.5) + 1
    refused(lambda: check_design(np.full((side, side), 3)), DesignError, "too large")
    refused(lambda: load_design("random:99999x99999"), DesignError, "too large")


def test_one_long_text_among_cells_costs_nothing(tmp_path: Path) -> None:
    """numpy would make room for the text in every cell: here 40 GB."""
    rows = [["x" * 1_000_000] + [1] * 10_000]
    refused(lambda: check_design(rows), DesignError, "must hold numbers")
    (tmp_path / "a.json").write_text(json.dumps({"body": rows}))
    refused(lambda: load_design(tmp_path / "a.json"), DesignError, "must hold numbers")
    refused(lambda: read_file(tmp_path / "a.json"), DesignError, "must hold numbers")


def test_aliases_do_not_multiply() -> None:
    lines = ["a0: &a0 [x, x]"] + [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 30)]
    with bounded(seconds=5), pytest.raises(Unreadable, match="alias"):
        parse_yaml("\n".join(lines))
    for text, words in (("[" * 5000, "deeply"), ("a: ${oc.env:HOME}", "reference"), ("a: 2001-99-99", "month")):
        with bounded(seconds=5), pytest.raises(Unreadable, match=words):
            parse_yaml(text)
    assert parse_yaml(config_text())["task"] == "Walker-v0"


# -------------------------------------------------------------------------------------------------- checkpoints


def test_a_policy_takes_memory_for_weights_that_are_there(tmp_path: Path) -> None:
    good = checkpoint_content()
    one = torch.ones(1)
    for change in (
        {"policy": good["policy"] | {"num_obs": 60_000, "hidden": [60_000, 60_000]}},
        {"policy": good["policy"] | {"num_obs": 10**12}},
        {"policy": good["policy"] | {"hidden": [2**63]}},
        {"actor_state_dict": good["actor_state_dict"] | {"mlp.0.weight": one.expand(8, 6)}},
        {"actor_state_dict": good["actor_state_dict"] | {"mlp.0.weight": torch.full((8, 6), torch.nan)}},
    ):
        torch.save(good | change, tmp_path / "a.pt")
        refused(lambda: load_controller(tmp_path / "a.pt"), RunError, "policy of another kind")


# ----------------------------------------------------------------------------------------------------- archives


@pytest.mark.parametrize("scheme", SCHEMES)
def test_an_archive_has_our_schema_and_no_other(tmp_path: Path, scheme: str) -> None:
    path = tmp_path / "archive.sqlite"
    path.write_bytes(archive_bytes())
    Archive.read(path).close()
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        db.executescript(scheme)
    refused(lambda: Archive.read(path), RunError, "damaged")


@pytest.mark.parametrize(
    "change",
    [
        "candidates SET fitness = 'x'",
        "candidates SET fitness = 9e999",
        "candidates SET policy = '/etc/passwd'",
        "candidates SET policy = '../../x'",
        "candidates SET body = '[[[1]]]'",
        "candidates SET body = zeroblob(9)",
        "candidates SET body = '" + "[" * 5000 + "'",
        "candidates SET steps = 1.5",
        "curves SET value = 'x'",
        "parents SET parent = 99",
    ],
)
def test_rows_of_an_archive_are_of_the_kinds_we_write(tmp_path: Path, change: str) -> None:
    path = tmp_path / "archive.sqlite"
    path.write_bytes(archive_bytes())
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        db.execute(f"UPDATE {change}")

    def read() -> None:
        with Archive.read(path) as archive:
            archive.records()

    refused(read, RunError, "damaged")


def test_a_schema_that_is_no_text(tmp_path: Path) -> None:
    """SQLite's complaint repeats the damaged bytes, which Python then cannot decode."""
    data = archive_bytes()
    for word in (b"CREATE TABLE curves", b"candidate INTEGER NOT NULL", b"CREATE VIEW generations"):
        assert word in data
        (tmp_path / "archive.sqlite").write_bytes(data.replace(word, word[:3] + b"\xce" + word[4:]))
        refused(lambda: Archive.read(tmp_path / "archive.sqlite"), RunError, "damaged")
