"""Flooding a body by its cells: a second way to see whether it hangs together."""

import numpy as np


def pieces(body: np.ndarray) -> int:
    """Groups of filled cells that hang together."""
    left = set(zip(*np.nonzero(body), strict=True))
    count = 0
    while left:
        count, front = count + 1, [left.pop()]
        while front:
            r, c = front.pop()
            near = {(r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)} & left
            left -= near
            front += near
    return count
