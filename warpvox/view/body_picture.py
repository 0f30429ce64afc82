"""Pictures of bodies and worlds before any simulation."""

import math
from collections.abc import Sequence

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


def draw_bodies(
    bodies: Sequence[Design],
    captions: Sequence[Sequence[str]] = (),
    title: str = "",
    cell: int = 28,
    shades: Sequence[float] | None = None,
    columns: int = 5,
) -> Image.Image:
    """Draw bodies in a grid with a caption below each, as one picture.

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
    bodies = [as_grid(body) for body in bodies]
    if not bodies or len(captions or bodies) != len(bodies):
        raise DesignError(f"It takes a body or more, and a caption for each, not {len(bodies)} and {len(captions)}.")
    captions = captions or [()] * len(bodies)

    # Sizes in pixels
    gap = cell
    line = 22
    high = max(body.shape[0] for body in bodies) * cell
    wide = max(body.shape[1] for body in bodies) * cell
    text_height = max(len(caption) for caption in captions) * line
    columns = min(len(bodies), check_integer("columns", columns, 1))
    rows = math.ceil(len(bodies) / columns)
    step_x = wide + gap
    step_y = high + text_height + gap
    top = gap
    if title:
        top += line + gap // 2
    width = max(gap + columns * step_x, 2 * gap + round(font(20).getlength(title)))  # a title may be the wider
    image = Image.new("RGB", (width, top + rows * step_y), "white")

    draw = ImageDraw.Draw(image)
    if title:
        draw.text((gap, gap // 2 + 4), title, INK, font(20))
    for number, (body, caption) in enumerate(zip(bodies, captions, strict=True)):
        row, column = divmod(number, columns)
        left = gap + column * step_x
        upper = top + row * step_y
        lower = upper + high

        # Paper from white to green
        if shades is not None:
            margin = gap // 3
            paper = tuple(round(255 + shades[number] * (green - 255)) for green in (126, 200, 150))
            corners = (left - margin, upper - margin, left + wide + margin, lower + text_height + margin)
            draw.rectangle(corners, fill=paper)

        # Cells
        for (row, column), kind in np.ndenumerate(body):
            x = left + column * cell
            y = lower + (row - body.shape[0]) * cell
            square = (x, y, x + cell - 1, y + cell - 1)
            if kind:
                draw.rectangle(square, fill=cell_colour(int(kind)), outline=INK)
            else:
                draw.rectangle(square, outline=(238, 241, 245))

        for place, text in enumerate(caption):
            draw.text((left, lower + 8 + place * line), text, (88, 96, 110) if place else INK, font(16))
    return image


AIR = 2
"""Rows of empty space above the world in its picture, in voxels."""


def scene_of_world(world: World) -> tuple[Scene, np.ndarray]:
    """Convert a world to a scene and its initial points, float64 ``[P, 2]`` in simulator units.

    SimulationError: the world has nothing that can move.
    """
    compiled = compile_world(world, Physics())
    return scene_of(compiled), np.array([point for body in compiled.bodies for point in body.points])


def draw_world(world: World) -> Image.Image:
    """Draw a whole world with a ruler in voxels below.

    SimulationError: the world has nothing that can move.
    """
    scene, points = scene_of_world(world)
    width = world.width + 2 * BELOW
    height = world.height + BELOW + AIR
    # The longer side has 1600 pixels at most, unless the world is very large.
    scale = int(np.clip(1600 / max(width, height), 6, 32))
    canvas = Canvas(scene, (round(width * scale), round(height * scale)), scale)
    return canvas.picture(points, (-round(BELOW * scale), -round(BELOW * scale)))
