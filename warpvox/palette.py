"""Colours of cells, the same in pictures, USD and the browser player; bodies as SVG."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpvox.types import ACTION_HIGH, ACTION_LOW, ACTUATORS, MATERIALS, Cell

if TYPE_CHECKING:
    from warpvox.design import Design

LEVELS = 17
"""Number of shades of an actuator; odd, so that the middle one means "at rest"."""
_MIDDLE = LEVELS // 2


def palette() -> np.ndarray:
    """Return all colours of cells, uint8 ``[colours, 3]``; :func:`colour_index` gives indices into it."""
    knots = (0, _MIDDLE, LEVELS - 1)
    shades = []
    for material in MATERIALS.values():
        channels = np.transpose(material.colours)
        shades.append(np.stack([np.interp(range(LEVELS), knots, channel) for channel in channels], axis=1))
    return np.rint(np.concatenate(shades)).astype(np.uint8)


def colour_index(cells: np.ndarray, stretch: np.ndarray) -> np.ndarray:
    """Return each cell's row in :func:`palette` from its type (1 to 5) and stretch, int32."""
    wide = np.clip(stretch, ACTION_LOW, ACTION_HIGH) - 1
    level = _MIDDLE + wide * np.where(wide < 0, _MIDDLE / (1 - ACTION_LOW), _MIDDLE / (ACTION_HIGH - 1))
    actuated = np.isin(cells, ACTUATORS)
    shade = np.where(actuated, np.rint(level), _MIDDLE).astype(np.int32)
    return (np.asarray(cells, np.int32) - 1) * LEVELS + shade


def cell_colour(cell: int) -> tuple[int, int, int]:
    """Return the colour of a cell at rest."""
    return MATERIALS[Cell(cell)].colours[1]


def body_svg(body: Design, cell: int = 8) -> str:
    """Draw a body as an ``<svg>`` element, ``cell`` pixels per cell.

    The paths have the classes ``c1`` to ``c4`` beside their colours and edges, so that a page can restyle them.
    """
    rows, columns = body.shape
    parts = []
    for kind in sorted({int(value) for value in np.unique(body)} - {int(Cell.EMPTY)}):
        squares = "".join(f"M{x} {y}h1v1h-1z" for y, x in np.argwhere(body == kind).tolist())
        colour = "#{:02x}{:02x}{:02x}".format(*cell_colour(kind))
        parts.append(f'<path class="c{kind}" fill="{colour}" d="{squares}"/>')
    names = sorted({MATERIALS[Cell(value)].name for value in np.unique(body) if value})
    label = f"body of {rows} x {columns} cells: {', '.join(names)}"
    return (
        f'<svg class="body" role="img" aria-label="{label}" viewBox="-.1 -.1 {columns + 0.2:g} {rows + 0.2:g}"'
        f' width="{columns * cell}" height="{rows * cell}" stroke="#1c1e24" stroke-width=".06">{"".join(parts)}</svg>'
    )
