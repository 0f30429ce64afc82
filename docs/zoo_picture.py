"""Draws the robots of the zoo at work: ``python docs/zoo_picture.py`` (``make zoo_picture``).

Not part of the library. Every robot repeats its recorded episode, of which the first six seconds are shown, in a
picture for the page of its task and in a tile of the picture of all. Two of one task also meet noise on their actions:
a gait that was chosen by a single episode, and the robot of the zoo.
"""

from pathlib import Path
from typing import Any, cast

import numpy as np
from PIL import Image, ImageDraw

from warpvox.algos.disturbance import Disturbed
from warpvox.devices.startup import prepare
from warpvox.envs.registry import get_task, task_ids
from warpvox.io.writing import atomic_path
from warpvox.robots.entry import Robot, read_robot, zoo, zoo_tasks
from warpvox.robots.replay import SEEDS, robot_env
from warpvox.robots.returns import EPISODES
from warpvox.view.painter import INK, Painter, font
from warpvox.view.rollout import record

IMAGES = Path(__file__).parent / "images"
FILM = (320, 150)
"""Size of the picture of one robot; every other frame is shown, to keep it small."""
COLUMNS, TILE, LABEL, GAP = 8, (112, 76), 13, 4
VOXELS = 13.0
"""Voxels from the bottom to the top of a tile."""
PICTURES, PAUSE = 60, 80
"""Pictures, and milliseconds of each."""
LONGEST = 300
"""Control steps that are shown of an episode."""
PAPER = (255, 255, 255)
FRAGILE = Path(__file__).parent / "results" / "UpStepper-v0_one_episode.npz"
"""A gait chosen by its return in one undisturbed episode."""


def tiles_of(robot: Robot) -> list[Image.Image]:
    """The pictures of a robot's first recorded episode; writes its own picture."""
    env = robot_env(robot, SEEDS[:1] if get_task(robot.task).is_random else (0,))
    rollout = record(env, robot.policy)
    frames = np.linspace(0, min(int(rollout.lengths[0]), LONGEST), PICTURES).round().astype(int).tolist()
    film = Painter(rollout, 0, FILM, VOXELS)
    save(IMAGES / "tasks" / f"{robot.task}.webp", [film.frame(frame) for frame in frames[::2]], 2 * PAUSE, quality=40)
    painter = Painter(rollout, 0, TILE, VOXELS)
    return [painter.frame(frame) for frame in frames]


def save(target: Path, pictures: list[Image.Image], pause: int, quality: int) -> None:
    """Write an animation that repeats."""
    target.parent.mkdir(exist_ok=True)
    options = {"save_all": True, "append_images": pictures[1:], "duration": pause, "loop": 0, "method": 6}
    with atomic_path(target) as temporary:
        pictures[0].save(temporary, quality=quality, **options)
    print(f"{target}: {target.stat().st_size / 1e6:.2f} MB", flush=True)


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
            pen.text((x + TILE[0], y + LABEL / 2), f"{robot.robust_return:.1f}", INK, letters, "rm")
        print(f"{name}: {robot.robust_return:.3f} under noise")
    return sheets


def nudged() -> list[Image.Image]:
    """A gait and a policy with feedback, without noise and with it: of all episodes that with the median return."""
    known = read_robot(FRAGILE)
    robots = {"open loop, chosen by one episode": known, "feedback, chosen under noise": zoo(known.task)}
    sheets = [Image.new("RGB", (2 * (FILM[0] + GAP) + GAP, 2 * (FILM[1] + 2 * LABEL)), PAPER) for _ in range(PICTURES)]
    for row, (name, robot) in enumerate(robots.items()):
        for column, part in enumerate(("nominal", "noise")):
            env = robot_env(robot, range(SEEDS[0], SEEDS[0] + EPISODES))
            rollout = record(env, Disturbed(cast(Any, robot.policy), env, (part,), SEEDS[0]))
            median = int(np.argsort(rollout.returns[-1])[EPISODES // 2])
            painter = Painter(rollout, median, FILM, VOXELS)
            frames = np.linspace(0, int(rollout.lengths[median]), PICTURES).round().astype(int).tolist()
            x, y = GAP + column * (FILM[0] + GAP), row * (FILM[1] + 2 * LABEL)
            text = f"{name}; {part}: {rollout.returns[-1, median]:.2f}"
            for sheet, frame in zip(sheets, frames, strict=True):
                sheet.paste(painter.frame(frame), (x, y + 2 * LABEL - GAP))
                ImageDraw.Draw(sheet).text((x, y + LABEL), text, INK, font(11), "lm")
            print(text)
    return sheets


def main() -> None:
    """Write the pictures."""
    prepare(1, 0)
    save(IMAGES / "nudge.webp", nudged()[::2], 3 * PAUSE, quality=40)
    known = zoo_tasks()
    save(IMAGES / "zoo.webp", draw([name for name in task_ids() if name in known]), PAUSE, quality=55)


if __name__ == "__main__":
    main()
