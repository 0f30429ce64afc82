"""Worlds as they begin, as pictures: nothing is simulated."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from PIL import Image

from warpvox.compile import compile_world
from warpvox.types import Physics
from warpvox.view.painter import BELOW, Canvas, save_png
from warpvox.view.scene import Scene, scene_of
from warpvox.world import World

LONGEST = 1600
"""Pixels that the longer side of a picture has at most, unless the world is very large."""
SCALES = (6, 32)
AIR = 2  # voxels above the world


def scene_of_world(world: World) -> tuple[Scene, np.ndarray]:
    """A world as a scene, and its points as they begin, float64 ``[P, 2]`` in simulator units.

    SimulationError: the world has nothing that can move.
    """
    compiled = compile_world(world, Physics())
    return scene_of(compiled), np.array([point for body in compiled.bodies for point in body.points])


def draw_world(world: World) -> Image.Image:
    """The whole world with all its objects, with the distance in voxels below.

    SimulationError: the world has nothing that can move.
    """
    scene, points = scene_of_world(world)
    width, height = world.width + 2 * BELOW, world.height + BELOW + AIR
    scale = int(np.clip(LONGEST / max(width, height), *SCALES))
    canvas = Canvas(scene, (round(width * scale), round(height * scale)), scale)
    return canvas.picture(points, (-round(BELOW * scale), -round(BELOW * scale)))


def write_world_png(world: World, path: str | os.PathLike[str]) -> Path:
    """Write what :func:`draw_world` draws. Returns the path."""
    return save_png(draw_world(world), path)
