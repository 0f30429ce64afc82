"""Bodies and worlds as text on the terminal: coloured cells, or letters without colours."""

from collections.abc import Sequence
from itertools import groupby

import numpy as np
from rich.color import Color
from rich.console import Console
from rich.style import Style
from rich.text import Text

from warpvox.io.console import echo
from warpvox.palette import cell_colour
from warpvox.types import EMPTY_LETTER, MATERIALS, Cell
from warpvox.world import World

UPPER, LOWER = "▀", "▄"


def body_rows(bodies: Sequence[np.ndarray], captions: Sequence[str], console: Console) -> Text:
    """Draw bodies as text side by side, as many as the console is wide, with a caption below each."""
    colour = _has_colour(console)
    wide = 2 if colour else 1
    gap = 3
    columns = [max(body.shape[1] * wide, len(caption)) + gap for body, caption in zip(bodies, captions, strict=True)]
    room = sum(np.cumsum(columns) - gap <= console.width) or 1
    high = max(body.shape[0] for body in bodies[:room])
    text = Text(no_wrap=True)
    for row in range(-high, 0):  # bodies stand on the same line
        for body, width in zip(bodies[:room], columns[:room], strict=True):
            cells = body[row] if row >= -len(body) else []
            for cell in map(int, cells):
                style = f"on rgb({','.join(map(str, cell_colour(cell)))})" if colour and cell else ""
                text.append("  " if colour else _letter(cell), style)
            text.append(" " * (width - len(cells) * wide))
        text.append("\n")
    for caption, width in zip(captions[:room], columns[:room], strict=True):
        text.append(caption.ljust(width))
    return text


def print_world(world: World, console: Console) -> None:
    """Print a world as coloured cells; a world wider than the console is split into pieces."""
    cells = world.grid()
    colour = _has_colour(console) and not console.options.ascii_only
    fold = max(console.width - 1, 10)
    kinds = [Cell(kind) for kind in np.unique(cells) if kind]
    echo(console, f"world: {world.width} x {world.height} cells")
    if colour:
        console.print(Text.assemble(*((f"{UPPER} {MATERIALS[kind].name}  ", _style(kind)) for kind in kinds)))
    else:
        echo(console, ", ".join(f"{_letter(kind)} {MATERIALS[kind].name}" for kind in kinds))
    for start in range(0, world.width, fold):
        if start:
            console.print()
        piece = cells[:, start : start + fold]
        lines = _blocks(piece) if colour else [Text("".join(map(_letter, row))) for row in piece]
        for _, equal in groupby(lines, key=lambda line: (line.plain, line.spans)):
            rows = list(equal)  # of many equal ones in succession only the first and the last
            if len(rows) > 5:
                rows[1:-1] = [Text(f"  ({len(rows) - 2} more rows like these)", style="dim")]
            for row in rows:
                console.print(row, soft_wrap=True)


def _letter(cell: int) -> str:
    return MATERIALS[Cell(cell)].letter if cell else EMPTY_LETTER


def _has_colour(console: Console) -> bool:
    return console.is_terminal and console.color_system is not None


def _style(front: int, back: int = 0) -> Style:
    colours = [Color.from_rgb(*cell_colour(kind)) if kind else None for kind in (front, back)]
    return Style(color=colours[0], bgcolor=colours[1])


def _blocks(cells: np.ndarray) -> list[Text]:
    """Draw cells as half-block characters, two rows of cells in a line of text."""
    if len(cells) % 2:
        cells = np.concatenate([np.zeros_like(cells[:1]), cells])
    lines = []
    for pairs in cells.reshape(-1, 2, cells.shape[1]).transpose(0, 2, 1).tolist():
        halves = ((UPPER, _style(up, down)) if up else (LOWER, _style(down)) if down else " " for up, down in pairs)
        lines.append(Text.assemble(*halves))
    return lines
