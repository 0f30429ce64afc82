"""The benchmark's worlds as files in the format of EvoGym's design tool, under the names of the release."""

import shutil
import tempfile
from functools import cache
from multiprocessing.util import Finalize
from pathlib import Path

from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.worlds import block
from warpvox.world import World

__all__ = ["world_files"]


@cache
def world_files() -> str:
    """Write the benchmark's world files to a temporary folder and return the folder; removed at exit."""
    folder = tempfile.mkdtemp(prefix="warpvox-worlds-")
    # unlike atexit's functions it is called in multiprocessing's processes, and in none that is forked from this one
    Finalize(None, shutil.rmtree, (folder,), {"ignore_errors": True}, exitpriority=0)

    # As released: the four tasks about shapes share a file, Catcher-v0 uses another task's, blocks come one by one.
    worlds = {}
    for task in task_ids():
        if task != "Catcher-v0":
            about_shapes = task.startswith(("Area", "Wingspan", "Height"))
            objects = [obj for obj in get_task(task).objects if not obj.name.startswith("block_")]
            worlds["ShapeChange" if about_shapes else task] = objects
    single = {
        "package": block("peg", 3, 2, "S"),
        "peg": block("peg", 5, 1, "F"),
        "rigid_1x1": block("new_object_1", 1, 1, "R"),
        "rigid_2x2": block("new_object_2", 2, 2, "R"),
        "rigid_3x3": block("new_object_3", 3, 3, "R"),
    }
    for name, obj in single.items():
        worlds[name] = [obj]

    for name, objects in worlds.items():
        world = World()
        for obj in objects:
            world.add_object(obj)
        world.to_json(Path(folder) / f"{name}.json")
    return folder
