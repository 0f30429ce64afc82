"""Text of files is shown as text, advice can be pasted, names fit into a folder."""

import io
import shlex
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from hypothesis import given, strategies as st
from rich.console import Console
from rich.table import Table

from warpvox.cli.config import load
from warpvox.devices.startup import LOGGER, prepare
from warpvox.envs.vec_env import make_vec
from warpvox.io.console import echo, escaped, literal, shell_argument
from warpvox.runs import LONGEST_BYTES, as_name
from warpvox.view.rollout import Rollout, record

EVIL = "[/bold]\x1b]0;owned\x07\x1b[2J\r[link=x]a\u202eb\x9b31m"
"""Markup that is not closed, a new title for the window, an empty screen, letters that run backwards."""


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
    assert outcome.code == 0, outcome.err
    assert not set("\x1b\x07\x9b\r\u202e") & set(outcome.out + outcome.err)
    assert "[/bold]" in outcome.out.replace("\n", "")


def test_what_the_library_tells_is_part_of_the_output(capsys: pytest.CaptureFixture) -> None:
    for _ in range(2):
        prepare(torch.get_num_threads(), 0)
    LOGGER.warning("Compiling kernels")
    assert capsys.readouterr() == ("Compiling kernels\n", "")


def test_an_error_keeps_the_blanks_of_a_path_and_obeys_nothing(warpvox: Callable) -> None:
    outcome = warpvox("play", "run=a  \x1b[31mb")
    assert (outcome.code, outcome.err) == (2, outcome.err.replace("\x1b", ""))
    assert "a  \\x1b[31mb" in outcome.err


@pytest.mark.parametrize("folder", ["a b", "it's (ü) = ~", "a,b", '"x"', "$HOME;ls"])
def test_advice_can_be_pasted_anywhere(folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / folder).mkdir()
    monkeypatch.chdir(tmp_path)
    line = f"printf '%s' {shell_argument('run', folder)}"
    word = subprocess.run(["sh", "-c", line], capture_output=True, text=True, check=True, cwd="/").stdout
    assert word == f"run={tmp_path / folder}"
    assert load("play", [word]).run == str(tmp_path / folder)


def test_the_advice_of_a_run_in_an_odd_folder(warpvox: Callable) -> None:
    keys = "design=mini num_envs=8 threads=1 device=cpu ppo.steps=4 ppo.hidden=[8] ppo.epochs=1".split()
    outcome = warpvox("train", *keys, "max_iterations=1", "output_dir=läufe (1), it's")
    assert outcome.code == 0, outcome.err
    (advice,) = (line for line in outcome.out.splitlines() if line.startswith("look at it:"))
    words = shlex.split(advice.partition("warpvox ")[2])
    assert (words[0], words[2:]) == ("play", ["export=[gif,html]"])
    assert warpvox(*words[:2], "steps=2", "threads=1", "export=[]", "window=off").code == 0


@pytest.mark.parametrize("name", ["a" * 300, "界" * 90])
def test_a_name_that_is_too_long(name: str, warpvox: Callable, tmp_path: Path) -> None:
    for words in (("train", "design=mini"), ("play", "agent=zero")):
        outcome = warpvox(*words, f"name={name}")
        assert (outcome.code, outcome.err.count("\n")) == (2, 1)
        assert "name may have 100 characters" in outcome.err
    assert list(tmp_path.iterdir()) == []


def test_a_task_whose_id_is_too_long(warpvox: Callable, tmp_path: Path) -> None:
    (tmp_path / "long.py").write_text(
        "from dataclasses import replace\nfrom warpvox.envs.registry import get_task\n"
        "LONG = replace(get_task('Walker-v0'), id='L' * 300)\n"
    )
    outcome = warpvox("train", "design=mini", "num_envs=8", "threads=1", "task=long.py:LONG")
    assert (outcome.code, "150 bytes at most" in outcome.err) == (2, True), outcome.err
    assert not (tmp_path / "outputs").exists()


@given(st.text())
def test_any_text_as_a_name(text: str) -> None:
    name = as_name(text)
    assert len(name.encode()) <= LONGEST_BYTES
    assert "/" not in name
    assert name not in (".", "..")
