"""A command line in an empty folder, with runs so small that they take a second."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from episodes import short_episodes
from tiny import tiny


@pytest.fixture(scope="module", autouse=True)
def short_walks() -> Iterator[None]:
    """Walker-v0 ends after a tenth of its episode."""
    with short_episodes("Walker-v0"):
        yield


@pytest.fixture
def train(warpvox: Callable[..., Any]) -> Callable[..., Path]:
    """Make a small run; returns its folder."""

    def call(*words: str) -> Path:
        before = set(Path("outputs").glob("train/*/*"))
        many = any(word.startswith("designs") for word in words)
        warpvox(*(word for word in tiny("train", *words) if not many or word != "design=mini"))
        (folder,) = set(Path("outputs").glob("train/*/*")) - before
        return folder

    return call
