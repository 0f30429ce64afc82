"""GIFs that are written as their pictures are made.

Pillow keeps all pictures of an animation until the last is there. Here it encodes some at a time; a GIF is a header
with one palette and a row of blocks, so that the blocks of each part follow those of the part before.
"""

from collections.abc import Iterable
from io import BytesIO
from itertools import islice
from typing import BinaryIO

from PIL import Image

PART_BYTES = 1 << 24
"""Bytes of the pictures that are encoded together (16 MiB)."""


def write_pictures(file: BinaryIO, pictures: Iterable[Image.Image], pause: int) -> None:
    """Write an animation that loops.

    Args:
        pictures: one or more of mode P, of one size and with one palette.
        pause: milliseconds from one to the next.
    """
    pictures = iter(pictures)
    loops = True
    for first in pictures:
        # Pillow makes one of equal pictures that follow each other, which can stay for 655 seconds.
        count = max(1, min(PART_BYTES // (first.width * first.height), 655_350 // pause))
        part = [first, *islice(pictures, count - 1)]

        # The pictures as a GIF of their own
        buffer = BytesIO()
        options = {"loop": 0} if loops else {}
        options |= dict(save_all=True, append_images=part[1:], duration=pause, optimize=False, disposal=1)
        first.save(buffer, "GIF", **options)
        data = buffer.getvalue()

        # Its header is 13 bytes, then the palette if there is one; only the first part keeps it.
        end = 13
        packed = data[10]
        if packed & 0x80:
            end += 3 << ((packed & 7) + 1)
        # The last byte would end the file.
        file.write(data[:-1] if loops else data[end:-1])
        loops = False
    file.write(b";")
