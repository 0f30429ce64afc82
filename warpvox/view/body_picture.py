"""Bodies and worlds as they begin, as pictures: nothing is simulated."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from warpvox.checks import check_integer
from warpvox.compile import compile_world
from warpvox.design import Design, as_grid
from warpvox.errors import DesignError
from warpvox.palette import cell_colour
from warpvox.types import Physics
from warpvox.view.painter import BELOW, INK, Canvas, font
from warpvox.view.scene import Scene, scene_of
from warpvox.world import World

PAPER, FAINT, EMPTY = (255, 255, 255), (88, 96, 110), (238, 241, 245)
SHADE = (126, 200, 150)
COLUMNS = 5
"""Bodies in a row of a sheet."""


def draw_bodies(
    bodies: Sequence[Design],
    captions: Sequence[Sequence[str]] = (),
    title: str = "",
    cell: int = 28,
    shades: Sequence[float] | None = None,
    columns: int = COLUMNS,
) -> Image.Image:
    """A sheet with bodies in rows, each above its caption.

    Args:
        bodies: int8 ``[rows, columns]`` each.
        captions: lines of text for each body; none: no text at all.
        title: a line on top.
        cell: pixels of a cell.
        shades: for each body 0 to 1: how strongly the paper below it is coloured; None: not at all.
        columns: bodies in a row at most.

    Raises:
        DesignError: no body, one that is none, or missing captions.
    """
    gap, line = cell, 22
    bodies = [as_grid(body) for body in bodies]
    if not bodies or len(captions or bodies) != len(bodies):
        raise DesignError(f"It takes a body or more, and a caption for each, not {len(bodies)} and {len(captions)}.")
    high, wide = (max(body.shape[axis] for body in bodies) * cell for axis in (0, 1))
    captions = captions or [()] * len(bodies)
    lines = max(len(caption) for caption in captions)
    columns = min(len(bodies), check_integer("columns", columns, 1))
    step = (wide + gap, high + lines * line + gap)
    top = gap + (line + gap // 2 if title else 0)
    size = (gap + columns * step[0], top + -(-len(bodies) // columns) * step[1])
    # a title may be wider than a single body
    size = (max(size[0], 2 * gap + round(font(20).getlength(title))), size[1])
    image = Image.new("RGB", size, PAPER)
    pen = ImageDraw.Draw(image)
    if title:
        pen.text((gap, gap // 2 + 4), title, INK, font(20))
    for number, (body, caption) in enumerate(zip(bodies, captions, strict=True)):
        left, upper = gap + number % columns * step[0], top + number // columns * step[1]
        if shades is not None:
            margin, low = gap // 3, upper + high + lines * line
            paper = tuple(round(p + shades[number] * (s - p)) for p, s in zip(PAPER, SHADE, strict=True))
            pen.rectangle((left - margin, upper - margin, left + wide + margin, low + margin), fill=paper)
        for (row, column), kind in np.ndenumerate(body):
            x, y = left + column * cell, upper + high + (row - body.shape[0]) * cell
            colours: dict[str, Any] = {"fill": cell_colour(int(kind)), "outline": INK} if kind else {"outline": EMPTY}
            pen.rectangle((x, y, x + cell - 1, y + cell - 1), **colours)
        for place, text in enumerate(caption):
            pen.text((left, upper + high + 8 + place * line), text, INK if place == 0 else FAINT, font(16))
    return image


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
