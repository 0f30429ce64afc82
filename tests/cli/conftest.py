"""A command line in an empty folder, with runs so small that they take a second."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

SMALL = "design=mini num_envs=8 threads=1 device=cpu ppo.steps=4 ppo.hidden=[8] ppo.epochs=1 eval_interval=2".split()


@pytest.fixture
def train(warpvox: Callable[..., Any]) -> Callable[..., Path]:
    """Make a small run; returns its folder."""

    def call(*words: str) -> Path:
        before = set(Path("outputs").glob("train/*/*"))
        keys = [word.split("=")[0] for word in words]
        outcome = warpvox("train", *(word for word in SMALL if word.split("=")[0] not in keys), *words)
        assert outcome.code == 0, outcome.err
        (folder,) = set(Path("outputs").glob("train/*/*")) - before
        return folder

    return call
