"""Gallery of tasks: one picture with a robot at the start of each world."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from warpvox.design import Design, load_design
from warpvox.envs.registry import get_task, task_ids
from warpvox.envs.worlds import task_world
from warpvox.errors import RolloutError
from warpvox.io.writing import check_suffix
from warpvox.types import VOXEL
from warpvox.view.body_picture import scene_of_world
from warpvox.view.painter import BELOW, INK, PNG_SUFFIXES, Canvas, font, save_png

COLUMNS, TILE = 4, (324, 150)


def everywhere(design: str = "walker") -> list[tuple[str, Design, str]]:
    """Return (task, body, caption) for one body in every task, as input for :func:`draw_gallery`."""
    body = load_design(design)
    return [(task, body, task) for task in task_ids()]


def draw_gallery(shown: Sequence[tuple[str, Design, str]]) -> Image.Image:
    """Draw bodies in the worlds of tasks, row by row; ``shown``: (task, body, caption) each."""
    # Pixels of a caption, and between the worlds
    label = 24
    gap = 10
    columns = min(COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    width = TILE[0] + gap
    height = TILE[1] + label + gap
    sheet = Image.new("RGB", (columns * width + gap, rows * height + gap), (255, 255, 255))
    draw = ImageDraw.Draw(sheet)
    letters = font(14)
    for number, (task, body, caption) in enumerate(shown):
        row, column = divmod(number, columns)
        x = gap + column * width
        y = gap + row * height
        sheet.paste(_tile(get_task(task), body), (x, y))
        draw.text((x + 2, y + TILE[1] + label / 2), caption, INK, letters, "lm")
    return sheet


def _tile(task: Any, body: np.ndarray) -> Image.Image:
    """Draw a world with the robot at the left, so that the terrain ahead is visible."""
    scene, points = scene_of_world(task_world(task, body))
    robot = points[scene.robot_points] / VOXEL
    scale = 8  # pixels of a voxel
    view = np.array(TILE) / scale

    # Five voxels are between the left rim of the picture and the robot.
    left = robot[:, 0].min() - 5.0
    if scene.width + 2 * BELOW > view[0]:
        left = np.clip(left, -BELOW, scene.width + BELOW - view[0])
    else:
        left = (scene.width - view[0]) / 2

    # The middle of the robot lies below that of the picture, where the ground is not in sight.
    bottom = max(-BELOW, robot[:, 1].mean() - 0.42 * view[1])
    corner = np.rint(np.array([left, bottom]) * scale).astype(int)
    return Canvas(scene, TILE, scale).picture(points, (int(corner[0]), int(corner[1])))


def write_gallery(path: str | os.PathLike[str], shown: Sequence[tuple[str, Design, str]]) -> Path:
    """Write the picture of :func:`draw_gallery` as PNG; return the path. RolloutError: suffix other than .png."""
    check_suffix("The file of a gallery", path, PNG_SUFFIXES, RolloutError)
    # Few colours: as a palette the picture takes a fraction of the room, without a visible difference.
    return save_png(draw_gallery(shown).quantize(128, dither=Image.Dither.NONE), path, optimize=True)
