"""A command line in an empty folder, with runs so small that they take a second."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tiny import tiny

from warpvox.envs import registry
from warpvox.envs.registry import get_task
from warpvox.envs.spec import TaskSpec


@pytest.fixture(scope="module", autouse=True)
def short_episodes() -> Iterator[TaskSpec]:
    """Walker-v0 of a tenth of its length: whole episodes are most of what these commands do. Its own specification."""
    own = get_task("Walker-v0")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(registry._TASKS, "Walker-v0", replace(own, max_episode_steps=50))
        yield own


@pytest.fixture
def whole_episodes(short_episodes: TaskSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    """Walker-v0 as it is."""
    monkeypatch.setitem(registry._TASKS, "Walker-v0", short_episodes)


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
