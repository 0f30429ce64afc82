"""Episodes that are over soon: whole ones are most of what tests of commands, searches and pages would do."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest

from warpvox.envs import registry


@contextmanager
def short_episodes(*tasks: str, steps: int = 50) -> Iterator[None]:
    """Within the block episodes of these tasks have so many control steps at most."""
    with pytest.MonkeyPatch.context() as patch:
        for task in tasks:
            own = registry.get_task(task)
            patch.setitem(registry._TASKS, task, replace(own, max_episode_steps=min(steps, own.max_episode_steps)))
        yield
