"""Draws the robots of the zoo at work into one animated picture: ``python docs/zoo_picture.py`` (``make zoo_picture``).

Not part of the library. Every robot repeats its recorded episode, of which the first six seconds are shown.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from warpvox.cli.process import prepare
from warpvox.envs.registry import get_task, task_ids
from warpvox.io.writing import atomic_path
from warpvox.robots.entry import Robot, zoo, zoo_tasks
from warpvox.robots.replay import SEEDS, robot_env
from warpvox.view.painter import INK, Painter, font
from warpvox.view.rollout import record

FILE = Path(__file__).parent / "images" / "zoo.webp"
COLUMNS, TILE, LABEL, GAP = 8, (112, 76), 13, 4
VOXELS = 13.0
"""Voxels from the bottom to the top of a tile."""
PICTURES, PAUSE = 60, 80
"""Pictures, and milliseconds of each."""
LONGEST = 300
"""Control steps that are shown of an episode."""
PAPER = (255, 255, 255)


def tiles_of(robot: Robot) -> list[Image.Image]:
    """The pictures of a robot's first recorded episode."""
    env = robot_env(robot, SEEDS[:1] if get_task(robot.task).is_random else (0,))
    rollout = record(env, robot.policy)
    painter = Painter(rollout, 0, TILE, VOXELS)
    frames = np.linspace(0, min(int(rollout.lengths[0]), LONGEST), PICTURES).round().astype(int)
    return [painter.frame(int(frame)) for frame in frames]


def draw(names: list[str]) -> list[Image.Image]:
    """The animation's pictures: a tile a task, in the order of the paper."""
    width, height = TILE[0] + GAP, TILE[1] + LABEL + GAP
    rows = -(-len(names) // COLUMNS)
    sheets = [Image.new("RGB", (COLUMNS * width + GAP, rows * height), PAPER) for _ in range(PICTURES)]
    letters = font(9)
    for number, name in enumerate(names):
        robot = zoo(name)
        row, column = divmod(number, COLUMNS)
        x, y = GAP + column * width, row * height
        for sheet, tile in zip(sheets, tiles_of(robot), strict=True):
            sheet.paste(tile, (x, y + LABEL))
            pen = ImageDraw.Draw(sheet)
            pen.text((x, y + LABEL / 2), name.removesuffix("-v0"), INK, letters, "lm")
            pen.text((x + TILE[0], y + LABEL / 2), f"{robot.mean_return:.1f}", INK, letters, "rm")
        print(f"{name}: {robot.mean_return:.3f}")
    return sheets


def main() -> None:
    """Write the picture."""
    prepare(1, 0)
    known = zoo_tasks()
    sheets = draw([name for name in task_ids() if name in known])
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else FILE
    with atomic_path(target) as temporary:
        sheets[0].save(temporary, save_all=True, append_images=sheets[1:], duration=PAUSE, loop=0, quality=55, method=4)
    print(f"{target}: {target.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
