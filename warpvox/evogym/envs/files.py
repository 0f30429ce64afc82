"""The benchmark's worlds as files in the format of EvoGym's design tool, under the names of the release."""

from __future__ import annotations

from pathlib import Path

from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.worlds import block
from warpvox.world import World, WorldObject

__all__ = ["write_worlds"]

# As released: the four tasks about shapes share a file, Catcher-v0 uses another task's, blocks come one by one.
_SHARED = {"AreaMaximizer-v0": "ShapeChange", "Catcher-v0": None}
_SHARED |= dict.fromkeys(("AreaMinimizer-v0", "WingspanMaximizer-v0", "HeightMaximizer-v0"))
_SINGLE = {
    "package": block("peg", 3, 2, "S"),
    "peg": block("peg", 5, 1, "F"),
    "rigid_1x1": block("new_object_1", 1, 1, "R"),
    "rigid_2x2": block("new_object_2", 2, 2, "R"),
    "rigid_3x3": block("new_object_3", 3, 3, "R"),
}


def write_worlds(folder: str) -> None:
    """Write all of them into a folder."""
    for task in task_ids():
        name = _SHARED.get(task, task)
        if name is not None:
            objects = [obj for obj in get_task(task).objects if not obj.name.startswith("block_")]
            _write(folder, name, *objects)
    for name, obj in _SINGLE.items():
        _write(folder, name, obj)


def _write(folder: str, name: str, *objects: WorldObject) -> None:
    world = World()
    for obj in objects:
        world.add_object(obj)
    world.to_json(Path(folder) / f"{name}.json")
