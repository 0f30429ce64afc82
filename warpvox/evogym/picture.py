"""Pictures of a running simulation for any camera, without a display."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from PIL import Image, ImageDraw

from warpvox.palette import colour_index, palette
from warpvox.types import VOXEL
from warpvox.view.painter import GRID, INK, SKY, seen
from warpvox.view.scene import stretch

if TYPE_CHECKING:
    from warpvox.evogym.engine import Engine

__all__ = ["paint"]

SMOOTH = 2  # pictures are painted this many times larger, which makes their edges smooth


def paint(
    engine: Engine,
    middle: tuple[float, float],
    view: tuple[float, float],
    size: tuple[int, int],
    hide_background: bool = False,
    hide_grid: bool = False,
    hide_edges: bool = False,
    hide_voxels: bool = False,
) -> np.ndarray:
    """Render the present state as a picture, uint8 ``[height, width, 3]``.

    Args:
        middle: the centre of the picture, in simulator units.
        view: width and height of what is seen, in simulator units; stretched to the picture.
        size: width and height in pixels.
        hide_background: white instead of the sky.
        hide_grid, hide_edges, hide_voxels: leave out the grid, the outlines of objects, the cells.
    """
    large = (size[0] * SMOOTH, size[1] * SMOOTH)
    scale = np.array(large) / view
    corner = np.array(middle) - np.array(view) / 2
    image = Image.new("RGB", large, "white" if hide_background else SKY)
    draw = ImageDraw.Draw(image)
    if not hide_grid:
        for axis in (0, 1):
            # A line at every voxel; none where they would lie closer than three pixels
            if scale[axis] * VOXEL < 3 * SMOOTH:
                continue
            low = np.ceil(corner[axis] / VOXEL)
            high = np.floor((corner[axis] + view[axis]) / VOXEL)
            for at in ((np.arange(low, high + 1) * VOXEL - corner[axis]) * scale[axis]).tolist():
                line = (at, 0, at, large[1]) if axis == 0 else (0, large[1] - at, large[0], large[1] - at)
                draw.line(line, fill=GRID, width=SMOOTH)

    # Cells and outlines
    points = engine.positions(engine.time)
    # Clipped: drawing is exact within the picture, and far points would overflow Pillow's integers.
    places = np.clip((points - corner) * scale, -1e6, 1e6)
    places[:, 1] = large[1] - places[:, 1]
    if not hide_voxels:
        quads = places[engine.corners]
        shown = seen(quads, large)
        cells = engine.cells[shown]
        colours = palette()[colour_index(cells, stretch(cells, points[engine.corners[shown]]))]
        for quad, colour in zip(quads[shown].reshape(-1, 8).tolist(), colours.tolist(), strict=True):
            draw.polygon(quad, fill=tuple(colour))
    if not hide_edges:
        sides = places[engine.outlines]
        # An outline is a fourteenth of a voxel wide.
        width = max(1, round(1 / 14 * VOXEL * float(scale.min())))
        for side in sides[seen(sides, large)].reshape(-1, 4).tolist():
            draw.line(side, fill=INK, width=width)
    return np.asarray(image.reduce(SMOOTH))
