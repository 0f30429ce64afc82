"""GIFs that are written as their pictures are made.

Pillow keeps all pictures of an animation until the last is there. Here it encodes some at a time; a GIF is a header
with one palette and a row of blocks, so that the blocks of each part follow those of the part before.
"""

from collections.abc import Iterable, Iterator
from io import BytesIO
from itertools import chain, islice
from typing import BinaryIO

from PIL import Image

PART_BYTES = 1 << 24
"""Bytes of the pictures that are encoded together (16 MiB)."""
LONGEST = 655_350
"""Milliseconds that a picture can stay: Pillow makes one of equal pictures that follow each other."""
HEADER, TRAILER = 13, b";"
"""Bytes of the fixed header; what ends a file."""


def write_pictures(file: BinaryIO, pictures: Iterable[Image.Image], pause: int) -> None:
    """Write an animation that loops.

    Args:
        pictures: one or more of mode P, of one size and with one palette.
        pause: milliseconds from one to the next.
    """
    for number, part in enumerate(_parts(iter(pictures), pause)):
        head, blocks = _encoded(part, pause, loops=number == 0)
        file.write(blocks if number else head + blocks)
    file.write(TRAILER)


def _parts(pictures: Iterator[Image.Image], pause: int) -> Iterator[list[Image.Image]]:
    for first in pictures:
        count = max(1, min(PART_BYTES // (first.width * first.height), LONGEST // pause))
        yield list(islice(chain([first], pictures), count))


def _encoded(part: list[Image.Image], pause: int, loops: bool) -> tuple[bytes, bytes]:
    """Header with palette, and blocks, of some pictures as a GIF of their own."""
    buffer, options = BytesIO(), {"loop": 0} if loops else {}
    options |= dict(save_all=True, append_images=part[1:], duration=pause, optimize=False, disposal=1)
    part[0].save(buffer, "GIF", **options)
    data = buffer.getvalue()
    packed = data[10]
    end = HEADER + (3 << ((packed & 7) + 1) if packed & 0x80 else 0)
    return data[:end], data[end : -len(TRAILER)]
