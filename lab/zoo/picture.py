"""Pictures of the zoo's robots in motion: python -m lab.zoo.picture [zoo|front|nudge]

Every robot repeats its recorded episode. Its first six seconds are a film for the page of its task, and a tile of the
film of all. ``front`` draws four of them large and side by side, for the front page. ``nudge`` draws two robots of one
task without noise and with it: a gait that was chosen by a single episode, and the robot of the zoo.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import warpvox as wv
from warpvox.algos.robots import robot_env
from warpvox.view.render import Film
from warpvox.view.rollout import Rollout

IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"
FRAGILE = Path(__file__).with_name("UpStepper-v0_one_episode.npz")
"""Gait chosen by its return in a single undisturbed episode."""
FILM = (320, 150)
"""Size of one robot's film, at half the frame rate to keep files small."""
COLUMNS, TILE, LABEL, GAP = 8, (112, 76), 13, 4
FRONT, FRONT_TILE = ("Walker-v0", "UpStepper-v0", "Carrier-v0", "BridgeWalker-v0"), (300, 220)
"""Robots on the front page, and the size of each picture."""
VOXELS = 13.0
"""Height of a picture in voxels."""
PICTURES, PAUSE = 60, 80
"""Number of pictures in a film, and milliseconds between them."""
LONGEST = 300
"""Maximum number of control steps shown."""
PAPER, INK = (255, 255, 255), (28, 30, 36)


def pictures(rollout: Rollout, size: tuple[int, int], last: int, env: int = 0) -> list[Image.Image]:
    """Paint pictures of an environment, evenly spread up to a frame."""
    film = Film(rollout, env, size, hud=False, voxels=VOXELS)
    return [film.image(int(frame)) for frame in np.linspace(0, last, PICTURES).round()]


def save(target: Path, frames: list[Image.Image], pause: int, quality: int) -> None:
    """Write a looping animation."""
    target.parent.mkdir(parents=True, exist_ok=True)
    options = {"save_all": True, "append_images": frames[1:], "duration": pause, "loop": 0, "method": 6}
    frames[0].save(target, quality=quality, **options)
    print(f"{target}: {target.stat().st_size / 1e6:.2f} MB", flush=True)


def sheets(width: int, height: int) -> list[Image.Image]:
    return [Image.new("RGB", (width, height), PAPER) for _ in range(PICTURES)]


def episode(name: str) -> tuple[Rollout, int]:
    """Record an episode of a zoo robot; return it with the last frame to show."""
    robot = wv.zoo(name)
    rollout = wv.record(robot_env(robot, robot.about["seeds"][:1]), robot.own_policy)
    return rollout, min(int(rollout.lengths[0]), LONGEST)


def tiles_of(name: str, images: Path) -> list[Image.Image]:
    """Paint the pictures of a zoo robot, and write the film for its task's page."""
    rollout, last = episode(name)
    film = pictures(rollout, FILM, last)
    save(images / "tasks" / f"{name}.webp", film[::2], 2 * PAUSE, quality=40)
    return pictures(rollout, TILE, last)


def draw_front(images: Path = IMAGES, tasks: tuple[str, ...] = FRONT) -> None:
    """Write the film of the front page."""
    width = FRONT_TILE[0] + GAP
    frames = sheets(len(tasks) * width - GAP, FRONT_TILE[1])
    for number, name in enumerate(tasks):
        rollout, last = episode(name)
        for frame, tile in zip(frames, pictures(rollout, FRONT_TILE, last), strict=True):
            frame.paste(tile, (number * width, 0))
    save(images / "front.webp", frames, PAUSE, quality=50)


def draw_zoo(images: Path = IMAGES, tasks: list[str] | None = None) -> None:
    """Write a film of all robots, tiled in the order of the paper, and one film per task."""
    names = wv.task_ids() if tasks is None else tasks
    width, height = TILE[0] + GAP, TILE[1] + LABEL + GAP
    rows = -(-len(names) // COLUMNS)
    frames, letters = sheets(COLUMNS * width + GAP, rows * height), ImageFont.load_default(9)
    for number, name in enumerate(names):
        robot = wv.zoo(name)
        row, column = divmod(number, COLUMNS)
        x, y = GAP + column * width, row * height
        for frame, tile in zip(frames, tiles_of(name, images), strict=True):
            frame.paste(tile, (x, y + LABEL))
            pen = ImageDraw.Draw(frame)
            pen.text((x, y + LABEL / 2), name.removesuffix("-v0"), INK, letters, "lm")
            pen.text((x + TILE[0], y + LABEL / 2), f"{robot.robust_return:.1f}", INK, letters, "rm")
    save(images / "zoo.webp", frames, PAUSE, quality=55)


def draw_nudge(images: Path = IMAGES) -> None:
    """Write a film that compares a gait and a policy with feedback, with and without noise.

    Of the episodes with noise it shows that with the median return.
    """
    frames = sheets(2 * (FILM[0] + GAP) + GAP, 2 * (FILM[1] + 2 * LABEL))
    letters = ImageFont.load_default(11)
    robots = {"open loop, chosen by one episode": str(FRAGILE), "feedback, chosen under noise": "UpStepper-v0"}
    for row, (name, source) in enumerate(robots.items()):
        for column, protocol in enumerate(("nominal", "noise")):
            rollout = play(source, protocol)
            median = int(np.argsort(rollout.returns[-1])[rollout.num_envs // 2])
            x, y = GAP + column * (FILM[0] + GAP), row * (FILM[1] + 2 * LABEL)
            text = f"{name}; {protocol}: {rollout.returns[-1, median]:.2f}"
            tiles = pictures(rollout, FILM, int(rollout.lengths[median]), median)
            for frame, tile in zip(frames, tiles, strict=True):
                frame.paste(tile, (x, y + 2 * LABEL - GAP))
                ImageDraw.Draw(frame).text((x, y + LABEL), text, INK, letters, "lm")
            print(text)
    save(images / "nudge.webp", frames[::2], 3 * PAUSE, quality=40)


def play(source: str, protocol: str) -> Rollout:
    """Play episodes of a zoo robot or a file: 32 if the protocol disturbs them."""
    with tempfile.TemporaryDirectory() as folder:
        words = [
            f"zoo={source}",
            f"protocol={protocol}",
            f"output_dir={folder}",
            "window=off",
            "export=[]",
            "device=cpu",
        ]
        words += ["num_envs=32"] if protocol != "nominal" else []
        subprocess.run([sys.executable, "-m", "warpvox", "play", *words], check=True, stdout=subprocess.DEVNULL)
        (file,) = Path(folder).glob("play/*/*/rollout.npz")
        return Rollout.load(file)


if __name__ == "__main__":
    drawings = {"zoo": draw_zoo, "front": draw_front, "nudge": draw_nudge}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=drawings, default="zoo")
    drawings[parser.parse_args().what]()
