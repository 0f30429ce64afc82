"""Worlds on the terminal: two cells a character in colour, letters elsewhere."""

from __future__ import annotations

import numpy as np
from rich.color import Color
from rich.console import Console
from rich.style import Style
from rich.text import Text

from warpvox.cli.console import echo
from warpvox.types import Cell
from warpvox.view.palette import CELL_NAMES, RAMPS
from warpvox.world import World

__all__ = ["print_world"]

GLYPHS = {Cell.EMPTY: ".", Cell.RIGID: "#", Cell.SOFT: "o", Cell.H_ACT: "-", Cell.V_ACT: "|", Cell.FIXED: "%"}
UPPER, LOWER = "▀", "▄"
SAME_ROWS = 5
"""Equal rows of a world that are printed one by one."""


def print_world(world: World, console: Console) -> None:
    """Print a world; one that is wider than the console in pieces below each other."""
    cells = world.grid()
    colour = console.is_terminal and console.color_system is not None and not console.options.ascii_only
    fold = max(console.width - 1, 10)
    kinds = [Cell(kind) for kind in np.unique(cells) if kind]
    echo(console, f"world: {world.width} x {world.height} cells")
    if colour:
        legend = Text.assemble(*((f"{UPPER} {CELL_NAMES[kind]}  ", Style(color=_colour(kind))) for kind in kinds))
        console.print(legend)
    else:
        echo(console, ", ".join(f"{GLYPHS[kind]} {CELL_NAMES[kind]}" for kind in kinds))
    for start in range(0, world.width, fold):
        if start:
            console.print()
        piece = cells[:, start : start + fold]
        _print_lines(_blocks(piece) if colour else _letters(piece), console)


def _colour(kind: int) -> Color:
    return Color.from_rgb(*RAMPS[Cell(kind)][1])


def _letters(cells: np.ndarray) -> list[Text]:
    """A line for every row of cells."""
    return [Text("".join(GLYPHS[Cell(kind)] for kind in row)) for row in cells]


def _blocks(cells: np.ndarray) -> list[Text]:
    """A line for every two rows: half blocks, of which each half has the colour of a cell."""
    if len(cells) % 2:
        cells = np.concatenate([np.zeros_like(cells[:1]), cells])
    lines = []
    for upper, lower in zip(cells[::2].tolist(), cells[1::2].tolist(), strict=True):
        line = Text()
        for up, down in zip(upper, lower, strict=True):
            if up and down:
                line.append(UPPER, Style(color=_colour(up), bgcolor=_colour(down)))
            elif up or down:
                line.append(UPPER if up else LOWER, Style(color=_colour(up or down)))
            else:
                line.append(" ")
        lines.append(line)
    return lines


def _print_lines(lines: list[Text], console: Console) -> None:
    """Print the rows of a world; of many equal ones in a row only the first and the last."""
    start = 0
    while start < len(lines):
        end = start
        while end < len(lines) and lines[end] == lines[start]:
            end += 1
        rows = lines[start:end]
        if end - start > SAME_ROWS:
            rows = [lines[start], Text(f"  ({end - start - 2} more rows like these)", style="dim"), lines[end - 1]]
        for row in rows:
            console.print(row, soft_wrap=True)
        start = end
