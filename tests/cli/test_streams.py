"""Standard streams that nobody reads, that lack letters, or that were closed from the start."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fault_cases import TRAIN
from hypothesis import given
from hypothesis import strategies as st

from warpvox.cli import main
from warpvox.cli.streams import _fitted, lasting_output

UNREAD = "warpvox: nobody reads the output any more; going on without it\n"


@contextlib.contextmanager
def stdout_without_reader(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A pipe whose other end is closed, as standard output."""
    theirs, ours = os.pipe()
    os.close(theirs)
    with os.fdopen(ours, "w") as stream, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        yield stream


def test_a_training_goes_on_when_its_reader_has_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    with stdout_without_reader(monkeypatch):
        assert main(TRAIN) == 0
    assert capfd.readouterr().err.endswith(UNREAD)
    (run,) = tmp_path.glob("outputs/train/*/*")
    assert json.loads((run / "summary.json").read_text())["status"] == "done"


def test_a_listing_ends_quietly(tmp_path: Path) -> None:
    """``warpvox tasks | head``, to the end of the process, where Python flushes what is left."""
    theirs, ours = os.pipe()
    os.close(theirs)
    with os.fdopen(ours, "w") as stream:
        line = [sys.executable, "-m", "warpvox", "tasks"]
        done = subprocess.run(line, stdout=stream, stderr=subprocess.PIPE, text=True, cwd=tmp_path, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(os.name != "posix", reason="a shell closes the streams")
def test_streams_that_are_closed_become_no_other_file(tmp_path: Path) -> None:
    """What is printed goes nowhere: not into the first file that is opened."""
    body = (
        "import sys, os\nfrom warpvox.cli.streams import lasting_output\n"
        "with lasting_output():\n"
        "    with open('file', 'w') as file:\n"
        "        assert file.fileno() > 2\n"
        "        print('hello'); print('hello', file=sys.stderr); os.write(1, b'hello'); os.write(2, b'hello')\n"
    )
    line = ["/bin/sh", "-c", 'exec "$0" -c "$1" <&- >&- 2>&-', sys.executable, body]
    assert subprocess.run(line, cwd=tmp_path, check=False).returncode == 0
    assert (tmp_path / "file").read_bytes() == b""
    line = ["/bin/sh", "-c", 'exec "$0" -m warpvox tasks >&-', sys.executable]
    done = subprocess.run(line, stderr=subprocess.PIPE, text=True, cwd=tmp_path, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("encoding", ["cp1252", "ascii", "latin-1"])
@pytest.mark.parametrize("words", [["tasks", "Flipper-v0"], ["tasks", "Climber-v0"], ["tasks"]])
def test_a_terminal_that_lacks_letters_shows_others(
    encoding: str, words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "out"
    with open(file, "w", encoding=encoding) as stream, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        assert main(words) == 0
    text = file.read_text(encoding)
    assert "?" not in text
    if words[-1] == "Flipper-v0":
        assert "dtheta_robot" in text


@given(st.text(), st.sampled_from(["cp1252", "ascii", "koi8-r", "utf-8", "cp437", "shift_jis", "unknown"]))
def test_any_text_fits_any_encoding(text: str, encoding: str) -> None:
    fitted = _fitted(text, encoding)
    if encoding not in ("unknown", "utf-8"):
        fitted.encode(encoding)
    assert not text.isascii() or fitted == text


def test_other_errors_of_the_output_are_not_swallowed(monkeypatch: pytest.MonkeyPatch) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("there is no /dev/full")
    with open("/dev/full", "w") as stream, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        with pytest.raises(OSError, match="No space left"), lasting_output():
            print("hello", flush=True)
        patch.undo()
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def test_streams_are_as_before_afterwards(warpvox: Callable) -> None:
    before = sys.stdout, sys.stderr
    assert warpvox("tasks").code == 0
    assert (sys.stdout, sys.stderr) == before
