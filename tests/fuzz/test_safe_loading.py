"""Reading a file never runs code that is in it, and takes no memory for what the file only claims to hold."""

from __future__ import annotations

import ast
import io
import json
import pickle
import sqlite3
import struct
import tracemalloc
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import fuzz_mutate as mutate
import numpy as np
import pytest
import torch
from fuzz_files import SCHEMES, archive_bytes, checkpoint_content, config_text, rollout_bytes
from fuzz_harness import within

from warpvox.algos.checkpoints.check import check_claims
from warpvox.algos.checkpoints.files import load_controller, read_tensors
from warpvox.algos.codesign.archive import Archive
from warpvox.cli.plain_yaml import parse_yaml
from warpvox.cli.runs import find_run
from warpvox.design import LARGEST_BODY, check_design, load_design
from warpvox.editor.documents import read_file
from warpvox.errors import DesignError, RolloutError, RunError, WarpvoxError, WorldError
from warpvox.io.reading import INFLATION, ArrayFile, Unreadable, parse_json, read_bytes, read_npy
from warpvox.view.rollout import Rollout
from warpvox.world import LARGEST_GRID, World, WorldObject

MUCH = 40_000_000
"""Bytes of memory that reading a hostile file of some kilobytes may take; most take a thousandth."""


class Creates:
    """Pickles itself as a call that makes a file."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple:
        return Path.touch, (self.marker,)


def refused(read: Callable[[], object], error: type[WarpvoxError], words: str) -> None:
    """``read`` raises ``error`` with these words, soon, and with little memory."""
    tracemalloc.start()
    try:
        with within(10), pytest.raises(error, match=words) as caught:
            read()
        assert tracemalloc.get_traced_memory()[1] < MUCH
    finally:
        tracemalloc.stop()
    chain = [caught.value]
    while chain[-1] is not None:
        assert not isinstance(chain[-1], MemoryError)
        chain.append(chain[-1].__cause__ or chain[-1].__context__)


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
    parts = mutate.unzip(rollout_bytes()[0])
    for name in parts:
        (tmp_path / "r.npz").write_bytes(mutate.zip_bytes(parts | {name: mutate.npy_bytes(cells)}))
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


def npy(shape: str, data: bytes = b"", descr: str = "'<f8'") -> bytes:
    """An .npy file whose header says what it likes."""
    head = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + data


CLAIMS = [
    npy("(1000000000000,)"),
    npy("(1000000, 1000000)", b"\0" * 80),
    npy("(100,)", b"\0" * 8, "'|V1000000000'"),
    npy("()", b"", "('<f4', (100000, 100000))"),
    npy("(-1, -1)", b"\0" * 8),
    npy("(" + "9" * 3000 + ",)"),
    npy("(" * 3000),
]


@pytest.mark.parametrize("data", CLAIMS)
def test_arrays_are_as_large_as_they_claim(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.npy").write_bytes(data)
    refused(lambda: load_design(tmp_path / "a.npy"), DesignError, "cannot be read")
    for name in ("arr_0.npy", "arr_1.npy"):
        (tmp_path / "a.npz").write_bytes(
            mutate.zip_bytes({"arr_0.npy": mutate.npy_bytes(np.array([[3]]))} | {name: data})
        )
        refused(lambda: load_design(tmp_path / "a.npz"), DesignError, "cannot be read")
    (tmp_path / "r.npz").write_bytes(mutate.zip_bytes(mutate.unzip(rollout_bytes()[0]) | {"positions.npy": data}))
    refused(lambda: Rollout.load(tmp_path / "r.npz"), RolloutError, "damaged")


def test_a_bomb_is_not_unpacked(tmp_path: Path) -> None:
    """100 kB that stand for 100 MB: more than a design may have, and seen before any of it is unpacked."""
    size = 100_000_000
    with (
        zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("arr_0.npy", "w") as file,
    ):
        file.write(npy(f"({size},)", descr="'|i1'"))
        for _ in range(size // 10_000_000):
            file.write(bytes(10_000_000))
    assert (tmp_path / "a.npz").stat().st_size < 200_000
    refused(lambda: load_design(tmp_path / "a.npz"), DesignError, "are the limit")


def test_a_directory_that_lies_is_refused(tmp_path: Path) -> None:
    data = bytearray(mutate.zip_bytes({"arr_0.npy": mutate.npy_bytes(np.array([[3]], np.int8))}))
    struct.pack_into("<I", data, data.index(b"PK\x01\x02") + 24, 2**31)
    (tmp_path / "a.npz").write_bytes(data)
    with pytest.raises(Unreadable, match="claims"):
        ArrayFile(tmp_path / "a.npz", 2**33)


def test_no_byte_stands_for_more_than_the_stated_inflation(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", np.zeros(5_000_000))
    with ArrayFile(tmp_path / "a.npz", 2**30) as archive:
        assert archive.read("arr_0").shape == (5_000_000,)
    assert INFLATION * (tmp_path / "a.npz").stat().st_size > 5_000_000 * 8


def test_arrays_come_back_as_numpy_writes_them(tmp_path: Path) -> None:
    arrays = [
        np.arange(6).reshape(2, 3),
        np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        np.zeros((0, 4)),
        np.array(5),
    ]
    arrays += [np.arange(4, dtype=">i4"), np.array([True, False]), np.arange(24, dtype=np.uint8).reshape(2, 3, 4)]
    for array in arrays:
        np.save(tmp_path / "a.npy", array)
        np.savez_compressed(tmp_path / "a.npz", one=array)
        with ArrayFile(tmp_path / "a.npz", 10**6) as archive:
            for read in (read_npy(tmp_path / "a.npy", 10**6), archive.read("one")):
                assert read.dtype == array.dtype
                assert np.array_equal(read, array)
                assert read.flags.writeable


def test_files_have_a_limit(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"x" * 11)
    assert read_bytes(tmp_path / "a", 11) == b"x" * 11
    with pytest.raises(Unreadable, match="are the limit"):
        read_bytes(tmp_path / "a", 10)
    for name in ("nowhere", "a\0b", "x" * 5000, "."):
        with pytest.raises(Unreadable):
            read_bytes(tmp_path / name, 10)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 200_000, "deeply"),
        ('{"a":' * 100_000, "deeply"),
        ("[NaN]", "NaN is no number"),
        ("[-Infinity]", "no number"),
        ('{"a": 1, "b": {"c": 1, "c": 2}}', "'c' occurs twice"),
        (r'["\ud800"]', "half of a character"),
        ("1" * 5000, "not valid JSON"),
        ("\ufeff{}", "not valid JSON"),
        ("", "not valid JSON"),
        ("{} {}", "not valid JSON"),
    ],
)
def test_json_is_what_the_standard_says(text: str, words: str) -> None:
    with pytest.raises(Unreadable, match=words):
        parse_json(text)
    assert parse_json(r'["\ud83d\ude00", 1e5, {"a": null}]') == ["😀", 1e5, {"a": None}]


def test_many_names_are_compared_in_time() -> None:
    text = json.dumps({str(k): 0 for k in range(30_000)})[:-1] + ', "0": 1}'
    with within(5), pytest.raises(Unreadable, match="'0' occurs twice"):
        parse_json(text)


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
    with within(5), pytest.raises(Unreadable, match="alias"):
        parse_yaml("\n".join(lines))
    for text, words in (("[" * 5000, "deeply"), ("a: ${oc.env:HOME}", "reference"), ("a: 2001-99-99", "month")):
        with within(5), pytest.raises(Unreadable, match=words):
            parse_yaml(text)
    assert parse_yaml(config_text())["task"] == "Walker-v0"


# -------------------------------------------------------------------------------------------------- checkpoints


def checkpoint(path: Path, content: object, change: Callable[[bytes], bytes] = bytes) -> Path:
    """A checkpoint file whose description of the tensors was changed."""
    target = io.BytesIO()
    torch.save(content, target)
    parts = mutate.unzip(target.getvalue())
    name = next(name for name in parts if name.endswith("data.pkl"))
    path.write_bytes(mutate.zip_bytes(parts | {name: change(parts[name])}, packed=False))
    return path


def test_storages_are_as_large_as_they_claim(tmp_path: Path) -> None:
    path = tmp_path / "a.pt"
    check_claims(checkpoint(path, {"a": torch.arange(1000.0)}))
    large = b"J" + struct.pack("<i", 10**9)
    checkpoint(path, {"a": torch.arange(1000.0)}, lambda data: data.replace(b"M\xe8\x03", large))
    refused(lambda: read_tensors(path), RunError, "claims 4,000,000,000 bytes, and the file has 4,000")


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (b"\x80\x02cbuiltins\nbytearray\n(J\x00\xca\x9a\x3btR.", "builtins bytearray"),
        (b"\x80\x02cos\nsystem\n(X\x02\x00\x00\x00lstR.", "os system"),
        (b"\x80\x04\x8c\x02os\x8c\x06system\x93.", "SHORT_BINUNICODE"),
        (b"\x80\x02(X\x01\x00\x00\x00ai__main__\nx\n.", "INST"),
        (b"\x80\x02}r\xff\xff\xff\x7f.", "not"),
    ],
)
def test_a_checkpoint_names_only_tensors(tmp_path: Path, code: bytes, words: str) -> None:
    path = checkpoint(tmp_path / "a.pt", {}, lambda data: code)
    refused(lambda: load_controller(path), RunError, words)


def test_a_reference_cannot_be_put_aside(tmp_path: Path) -> None:
    """A tuple that was made earlier, and is not the one before the reference, is no reference."""
    honest = b"(X\x07\x00\x00\x00storagectorch\nFloatStorage\nX\x01\x00\x00\x000X\x03\x00\x00\x00cpuK\x01t"
    false = honest.replace(b"K\x01t", b"J" + struct.pack("<i", 10**9) + b"t")
    path = checkpoint(
        tmp_path / "a.pt", {"a": torch.ones(1)}, lambda d: b"\x80\x02" + false + b"q\x01" + honest + b"h\x01Q."
    )
    refused(lambda: read_tensors(path), RunError, "no storage")


def test_all_that_torch_saves_for_us_passes(tmp_path: Path) -> None:
    layer = torch.nn.Linear(3, 4)
    optimizer = torch.optim.Adam(layer.parameters())
    layer(torch.ones(1, 3)).sum().backward()
    optimizer.step()
    content = {
        "weights": layer.state_dict(),
        "optimizer": optimizer.state_dict(),
        "generator": torch.Generator().get_state(),
        "numbers": [0, -1, 2**62, 1.5, None, True, "0", (1, 2, 3, 4, 5), OrderedDict(a=1)],
        "shared": [layer.weight.detach(), layer.weight.detach()[0]],
        "types": [
            torch.zeros(2, dtype=getattr(torch, name)) for name in ("int64", "int32", "uint8", "bool", "float64")
        ],
    }
    torch.save(content, tmp_path / "a.pt")
    assert read_tensors(tmp_path / "a.pt")["numbers"] == content["numbers"]


def test_a_policy_takes_memory_for_weights_that_are_there(tmp_path: Path) -> None:
    good = checkpoint_content()
    one = torch.ones(1)
    for change in (
        {"policy": good["policy"] | {"num_obs": 60_000, "hidden": [60_000, 60_000]}},
        {"policy": good["policy"] | {"num_obs": 10**12}},
        {"policy": good["policy"] | {"width": 10**12}},
        {"policy": good["policy"] | {"hidden": [2**63]}},
        {"actor_state_dict": good["actor_state_dict"] | {"mlp.0.weight": one.expand(8, 6)}},
        {"actor_state_dict": good["actor_state_dict"] | {"mlp.0.weight": torch.full((8, 6), torch.nan)}},
    ):
        torch.save(good | change, tmp_path / "a.pt")
        refused(lambda: load_controller(tmp_path / "a.pt"), RunError, "policy of another kind")


# ----------------------------------------------------------------------------------------------------- archives


@pytest.mark.parametrize("scheme", [scheme for scheme in SCHEMES if scheme.split()[0] in ("DROP", "CREATE", "ALTER")])
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
