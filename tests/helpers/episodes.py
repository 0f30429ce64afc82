"""Short episodes, for fast tests of commands, searches and pages."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest

from warpvox.envs import registry


@contextmanager
def short_episodes(*tasks: str, steps: int = 50) -> Iterator[None]:
    """Limit the episodes of these tasks to a number of control steps within the block."""
    with pytest.MonkeyPatch.context() as patch:
        for task in tasks:
            own = registry.get_task(task)
            patch.setitem(registry._TASKS, task, replace(own, max_episode_steps=min(steps, own.max_episode_steps)))
        yield
