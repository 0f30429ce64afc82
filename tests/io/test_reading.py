"""Files: nothing is read beyond a limit, no array is unpickled, JSON is the standard's, and writes are whole."""

import os
import stat
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from warpvox.design import save_design
from warpvox.io.reading import ArrayFile, Unreadable, parse_json, read_bytes, read_npy, read_text
from warpvox.io.writing import atomic_path
from warpvox.world import World


def test_arrays_come_back_within_a_limit_and_without_pickle(tmp_path: Path) -> None:
    file, archive = tmp_path / "a.npy", tmp_path / "a.npz"
    for array in (np.asfortranarray(np.arange(6.0).reshape(2, 3)), np.zeros((0, 4)), np.arange(4, dtype=">i4")):
        np.save(file, array)
        np.savez_compressed(archive, one=array)
        with ArrayFile(archive, 10**4) as opened:
            for read in (read_npy(file, 10**4), opened.read("one")):
                assert read.dtype == array.dtype
                assert np.array_equal(read, array)
    with ArrayFile(archive, 10**4) as opened, pytest.raises(Unreadable):
        opened.read("on")
    np.savez_compressed(archive, one=np.zeros(10**6), two=np.array([{}], object))
    with pytest.raises(Unreadable):
        ArrayFile(archive, 10**6)
    with ArrayFile(archive, 10**7) as opened, pytest.raises(Unreadable):
        opened.read("two")
    (tmp_path / "a").write_bytes(b"x" * 11)
    for name in ("a", "nowhere", "a\0b", "."):
        with pytest.raises(Unreadable):
            read_bytes(tmp_path / name, 10)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 200_000, "deeply"),
        ("[NaN]", "NaN is no number"),
        ('{"a": 1, "b": {"c": 1, "c": 2}}', "'c' occurs twice"),
        (r'["\ud800"]', "half of a character"),
        ("{} {}", "not valid JSON"),
    ],
)
def test_json_is_what_the_standard_says(text: str, words: str) -> None:
    with refused(Unreadable, words):
        parse_json(text)
    assert parse_json(r'["\ud83d\ude00", 1e5, {"a": null}]') == ["😀", 1e5, {"a": None}]


def test_a_byte_order_mark_is_no_part_of_a_text(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(b"\xef\xbb\xbf[[3]]")  # as Notepad may save it
    assert parse_json(read_text(tmp_path / "a.json", 100)) == [[3]]


def test_a_write_makes_folders_keeps_the_suffix_and_gives_usual_permissions(tmp_path: Path) -> None:
    target = tmp_path / "a" / "b" / "result.npz"
    with atomic_path(target) as temporary:
        assert temporary.suffix == ".npz"
        assert temporary.parent == target.parent
        temporary.write_text("new")
    assert target.read_text() == "new"
    plain = tmp_path / "plain"
    plain.write_text("")
    assert stat.S_IMODE(target.stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)


@pytest.mark.skipif(os.name != "posix", reason="links need a right on Windows")
@pytest.mark.parametrize("save", [lambda path: World(3, 3).to_json(path), lambda path: save_design(path, [[3]])])
def test_of_a_link_that_the_user_has_named_the_file_behind_it_is_replaced(save: Callable, tmp_path: Path) -> None:
    real, link = tmp_path / "disk" / "a.json", tmp_path / "link.json"
    link.symlink_to(real)  # nothing is there yet
    for _ in range(2):
        save(link)
        assert (link.is_symlink(), real.is_file()) == (True, True)
    assert [file.name for file in real.parent.iterdir()] == ["a.json"]
