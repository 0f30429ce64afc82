"""Files that others made: nothing is read beyond a limit, and what comes back is what numpy and JSON mean."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from bounds import bounded
from damage import npy, zipped

from warpvox.io.reading import INFLATION, ArrayFile, Unreadable, parse_json, read_bytes, read_npy


def test_a_directory_that_lies_is_refused(tmp_path: Path) -> None:
    data = bytearray(zipped({"arr_0.npy": npy(np.array([[3]], np.int8))}))
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
    with bounded(seconds=5), pytest.raises(Unreadable, match="'0' occurs twice"):
        parse_json(text)
