"""Cells as SVG, for pages and notebooks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpvox.types import Cell
from warpvox.view.palette import CELL_NAMES, RAMPS

if TYPE_CHECKING:
    from warpvox.design import Design

__all__ = ["body_svg", "cell_colour"]


def cell_colour(cell: int) -> tuple[int, int, int]:
    """The colour of a cell at rest."""
    ramp = RAMPS[Cell(cell)]
    return ramp[len(ramp) // 2]


def body_svg(body: Design, cell: int = 8, title: str | None = None) -> str:
    """A body, or other cells, as an ``<svg>`` element, a path a material; ``cell`` is the size of a cell in pixels.

    The paths have the classes ``c1`` to ``c4`` beside their colours, so that a page can restyle them.
    """
    rows, columns = body.shape
    parts = [f"<title>{title}</title>"] if title else []
    for kind in sorted({int(value) for value in np.unique(body)} - {int(Cell.EMPTY)}):
        squares = "".join(f"M{x} {y}h1v1h-1z" for y, x in np.argwhere(body == kind).tolist())
        colour = "#{:02x}{:02x}{:02x}".format(*cell_colour(kind))
        parts.append(f'<path class="c{kind}" fill="{colour}" d="{squares}"/>')
    names = sorted({CELL_NAMES[Cell(int(value))] for value in np.unique(body) if value})
    label = f"body of {rows} x {columns} cells: {', '.join(names)}"
    return (
        f'<svg class="body" role="img" aria-label="{label}" viewBox="-.1 -.1 {columns + 0.2:g} {rows + 0.2:g}"'
        f' width="{columns * cell}" height="{rows * cell}">{"".join(parts)}</svg>'
    )
