"""A command line in an empty folder, with runs so small that they take a second."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
import torch

from warpvox.cli import main

SMALL = "design=mini num_envs=8 threads=1 device=cpu ppo.steps=4 ppo.hidden=[8] ppo.epochs=1 eval_interval=2".split()


class Outcome(NamedTuple):
    """What a command left: exit code and both streams."""

    code: int
    out: str
    err: str


@pytest.fixture
def warpvox(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture) -> Callable[..., Outcome]:
    """``warpvox("train", "seed=1")`` in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    # a reference that someone has made on this machine is none of the tests' business
    monkeypatch.setattr("warpvox.cli.benchmarks.reference.reference_folder", lambda: tmp_path / "no_reference")
    threads = torch.get_num_threads()

    def call(*words: str) -> Outcome:
        capfd.readouterr()
        code = main(words)
        torch.set_num_threads(threads)
        streams = capfd.readouterr()
        return Outcome(code, streams.out, streams.err)

    return call


@pytest.fixture
def train(warpvox: Callable[..., Outcome]) -> Callable[..., Path]:
    """Make a small run; returns its folder."""

    def call(*words: str) -> Path:
        before = set(Path("outputs").glob("train/*/*"))
        keys = [word.split("=")[0] for word in words]
        outcome = warpvox("train", *(word for word in SMALL if word.split("=")[0] not in keys), *words)
        assert outcome.code == 0, outcome.err
        (folder,) = set(Path("outputs").glob("train/*/*")) - before
        return folder

    return call
