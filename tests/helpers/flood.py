"""Connected pieces of a body by flood fill, as a second implementation."""

import numpy as np


def pieces(body: np.ndarray) -> int:
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
