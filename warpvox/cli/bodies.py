"""Bodies on the console: beside each other, in colours on a terminal, in letters elsewhere."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.text import Text

from warpvox.view.body_picture import cell_colour

__all__ = ["body_rows"]

GLYPHS = ".#o-|%"
"""Of empty, rigid, soft, horizontal actuator, vertical actuator and fixed cells."""
GAP = 3


def body_rows(bodies: Sequence[np.ndarray], captions: Sequence[str], console: Console) -> Text:
    """As many of the bodies as there is room for beside each other, with a caption below each."""
    colour = console.is_terminal and console.color_system is not None
    wide = 2 if colour else 1
    columns = [max(body.shape[1] * wide, len(caption)) + GAP for body, caption in zip(bodies, captions, strict=True)]
    room = sum(np.cumsum(columns) - GAP <= console.width) or 1
    high = max(body.shape[0] for body in bodies[:room])
    text = Text(no_wrap=True)
    for row in range(high):
        for body, width in zip(bodies[:room], columns[:room], strict=True):
            # bodies stand on the same line
            line = row - (high - body.shape[0])
            cells = body[line] if line >= 0 else []
            for cell in cells:
                if colour:
                    text.append("  ", f"on rgb({','.join(map(str, cell_colour(int(cell))))})" if cell else "")
                else:
                    text.append(GLYPHS[int(cell)])
            text.append(" " * (width - len(cells) * wide))
        text.append("\n")
    for caption, width in zip(captions[:room], columns[:room], strict=True):
        text.append(caption.ljust(width))
    return text
