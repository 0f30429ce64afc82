"""Names of files and folders that not every library, or every system, can have."""

import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from tiny import tiny

import warpvox as wv
from warpvox.design import save_design
from warpvox.editor.documents import check_file_name
from warpvox.errors import ConfigError, StorageError, WorldError
from warpvox.runs import check_name

ODD = os.fsdecode(b"bad\xff")


@pytest.mark.skipif(sys.platform != "linux", reason="names are UTF-8 elsewhere")
@pytest.mark.parametrize("command", ["train", "codesign", "play", "export", "evaluate", "curves"])
def test_a_folder_that_is_not_utf8_is_refused_before_it_is_made(command: str, warpvox: Callable) -> None:
    words = {
        "train": tiny("train", f"output_dir={ODD}"),
        "codesign": tiny("codesign", "task=Walker-v0", "search=random", f"output_dir={ODD}"),
        "play": ["play", "zoo=Walker-v0", f"output_dir={ODD}"],
        "export": ["export", "zoo=Walker-v0", "format=[onnx]", f"output_dir={ODD}"],
        "evaluate": ["evaluate", "runs=[zoo:Walker-v0]", f"output_dir={ODD}"],
        "curves": tiny("train", "-m", "seed=0,1", f"output_dir={ODD}"),
    }[command]
    warpvox(*words, fails="not UTF-8")
    assert not any(Path().iterdir())


@pytest.mark.skipif(sys.platform != "linux", reason="names are UTF-8 elsewhere")
def test_python_calls_refuse_it_too(tmp_path: Path) -> None:
    for call in (
        lambda: wv.train("Walker-v0", "mini", folder=tmp_path / ODD / "run", num_envs=8, max_iterations=1),
        lambda: save_design(tmp_path / ODD / "a.json", [[3]]),
    ):
        with pytest.raises(StorageError):
            call()
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("name", [".", "..", "...", "con", "NUL", "aux.json", "com1.tar.gz", "LPT9"])
def test_names_that_stand_for_something_else(name: str) -> None:
    with pytest.raises(ConfigError):
        check_name(name)
    with pytest.raises(WorldError):
        check_file_name(name)


@pytest.mark.parametrize("name", ["console", "a.b", "com", "nulls", "auxiliary.v2", ".hidden"])
def test_names_that_are_only_similar(name: str) -> None:
    check_name(name)
