"""Terrains: run-length text, the worlds of the tasks, and what happens when a robot does not fit."""

from __future__ import annotations

import json
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest

from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.worlds import rows, task_world
from warpvox.errors import WorldError

F, S = 5, 2


@pytest.mark.parametrize("line", ["3Q", "F3", "x", "2-F"])
def test_unreadable_lines_are_refused(line: str) -> None:
    with pytest.raises(WorldError, match="expected runs such as"):
        rows("thing", line)


@pytest.mark.parametrize("task", task_ids())
def test_worlds_have_the_checksums_of_the_reference(task: str) -> None:
    """Place, size and CRC of the cells of every object, as ``tests/parity/record.py --worlds`` has written them."""
    theirs = json.loads((Path(__file__).parent / "worlds.json").read_text())[task]
    ours = {
        obj.name: [obj.x, obj.y, obj.width, obj.height, crc32(obj.grid.tobytes())] for obj in get_task(task).objects
    }
    assert ours == theirs


def test_a_body_that_does_not_fit_is_refused_by_name_of_the_task() -> None:
    with pytest.raises(WorldError, match=r"5x6 body does not fit the world of Climber-v0: .*'pipe' at cell \(6, 1\)"):
        task_world(get_task("Climber-v0"), np.full((5, 6), 3, np.int8))
