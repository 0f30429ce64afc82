"""Text of files is shown as text, advice can be pasted, names fit into a folder."""

import io
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from fault_cases import TRAIN
from hypothesis import given, strategies as st
from rich.console import Console
from rich.table import Table
from tiny import tiny

from warpvox.cli import main
from warpvox.cli.config import load
from warpvox.devices.startup import LOGGER, prepare
from warpvox.envs.vec_env import make_vec
from warpvox.io.console import echo, literal
from warpvox.io.text import escaped, shell_argument, shown
from warpvox.runs import LONGEST_BYTES, as_name
from warpvox.view.rollout import Rollout, record

EVIL = "[/bold]\x1b]0;owned\x07\x1b[2J\r[link=x]a\u202eb\x9b31m"
"""Markup that is not closed, a new title for the window, an empty screen, letters that run backwards."""


def test_paths_are_shown_as_they_are_short(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path) -> str:
        raise ValueError(f"path is on mount 'D:', start on mount 'C:': {path}")

    monkeypatch.chdir(tmp_path)
    assert shown(tmp_path / "a") == "a"
    monkeypatch.setattr(os.path, "relpath", refuse)  # as on Windows between two drives
    assert shown(tmp_path / "a") == str(tmp_path / "a")


@given(st.text())
def test_nothing_that_a_terminal_obeys_gets_through(text: str) -> None:
    out = io.StringIO()
    console = Console(file=out, width=2000)
    echo(console, text)
    table = Table(title=literal(text))
    table.add_row(literal(text))
    console.print(table)
    assert all(ord(letter) >= 32 or letter == "\n" for letter in out.getvalue())
    assert escaped("über [gif,html] ✓") == "über [gif,html] ✓"


def spoilt(folder: Path) -> Path:
    """A rollout whose texts somebody has chosen with care."""
    file = folder / "evil.npz"
    rollout = record(make_vec("Walker-v0", ["mini"], 8, device="cpu", threads=1, auto_reset=False), "zero", 2)
    rollout.metadata.update(task=EVIL, agent=EVIL, environment=EVIL, diverged=True)
    rollout.save(file)
    assert Rollout.load(file).metadata["agent"] == EVIL
    return file


def test_a_rollout_of_somebody_elses(warpvox: Callable, tmp_path: Path) -> None:
    outcome = warpvox("play", f"rollout={spoilt(tmp_path)}", "window=off", "export=[]")
    assert not set("\x1b\x07\x9b\r\u202e") & set(outcome.out + outcome.err)
    assert "[/bold]" in outcome.out.replace("\n", "")


def test_what_the_library_tells_is_part_of_the_output(capsys: pytest.CaptureFixture) -> None:
    for _ in range(2):
        prepare(torch.get_num_threads(), 0)
    LOGGER.warning("Compiling kernels")
    assert capsys.readouterr() == ("Compiling kernels\n", "")


def test_an_error_keeps_the_blanks_of_a_path_and_obeys_nothing(warpvox: Callable) -> None:
    assert "\x1b" not in warpvox("play", "run=a  \x1b[31mb", fails="a  \\x1b[31mb").err


@pytest.mark.parametrize("folder", ["a b", "it's (ü) = ~", "a,b", '"x"', "$HOME;ls"])
def test_advice_can_be_pasted_anywhere(folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / folder).mkdir()
    monkeypatch.chdir(tmp_path)
    line = f"printf '%s' {shell_argument('run', folder)}"
    word = subprocess.run(["sh", "-c", line], capture_output=True, text=True, check=True, cwd="/").stdout
    assert word == f"run={tmp_path / folder}"
    assert load("play", [word]).run == str(tmp_path / folder)
    assert shell_argument("run", "outputs/~") == "'run=outputs/~'"  # short where that says the same
    assert shell_argument("run", "~/a") == f"'run={tmp_path}/~/a'"


def test_the_advice_of_a_run_in_an_odd_folder(warpvox: Callable) -> None:
    outcome = warpvox(*tiny("train", "output_dir=läufe (1), it's"))
    (advice,) = (line for line in outcome.out.splitlines() if line.startswith("look at it:"))
    words = shlex.split(advice.partition("warpvox ")[2])
    assert (words[0], words[2:]) == ("play", ["export=[gif,html]"])
    warpvox(*words[:2], "steps=2", "threads=1", "export=[]", "window=off")


@pytest.mark.parametrize("name", ["a" * 300, "界" * 90])
def test_a_name_that_is_too_long(name: str, warpvox: Callable, tmp_path: Path) -> None:
    for words in (("train", "design=mini"), ("play", "agent=zero")):
        warpvox(*words, f"name={name}", fails="name may have 100 characters")
    assert list(tmp_path.iterdir()) == []


def test_a_task_whose_id_is_too_long(warpvox: Callable, tmp_path: Path) -> None:
    (tmp_path / "long.py").write_text(
        "from dataclasses import replace\nfrom warpvox.envs.registry import get_task\n"
        "LONG = replace(get_task('Walker-v0'), id='L' * 300)\n"
    )
    warpvox("train", "design=mini", "num_envs=8", "threads=1", "task=long.py:LONG", fails="150 bytes at most")
    assert not (tmp_path / "outputs").exists()


@given(st.text())
def test_any_text_as_a_name(text: str) -> None:
    name = as_name(text)
    assert len(name.encode()) <= LONGEST_BYTES
    assert "/" not in name
    assert name not in (".", "..")


def test_a_training_goes_on_when_its_reader_has_gone(tmp_path: Path, monkeypatch, capfd: pytest.CaptureFixture) -> None:
    monkeypatch.chdir(tmp_path)
    theirs, ours = os.pipe()
    os.close(theirs)
    with os.fdopen(ours, "w") as stream, monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", stream)
        assert main(TRAIN) == 0
    assert capfd.readouterr().err.endswith("warpvox: nobody reads the output any more; going on without it\n")
    (run,) = tmp_path.glob("outputs/train/*/*")
    assert json.loads((run / "summary.json").read_text())["status"] == "done"


@pytest.mark.skipif(os.name != "posix", reason="a shell makes the streams")
@pytest.mark.parametrize("streams", ["| true", pytest.param("<&- >&-", marks=pytest.mark.slow)])
def test_a_listing_ends_quietly(streams: str, tmp_path: Path) -> None:
    line = f'"{sys.executable}" -m warpvox tasks {streams}'
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run(line, shell=True, capture_output=True, text=True, cwd=tmp_path, env=environment, check=False)
    assert (done.returncode, done.stderr) == (0, "")
