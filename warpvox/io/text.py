"""Text from files, made fit to be shown: it can neither command a terminal nor look like our own markup."""

import html
import math
import os
import shlex
import unicodedata
from pathlib import Path


def shown(path: Path) -> str:
    """A path as people like to read it: relative to here where that is shorter."""
    try:
        relative = os.path.relpath(path)
    except ValueError:  # another drive of Windows
        return str(path)
    return relative if len(relative) < len(str(path)) else str(path)


def escaped(text: object) -> str:
    """``text`` with what a terminal would obey written as ``\\x1b``; an end of line is among it."""
    written = []
    for character in str(text):
        number = ord(character)
        # Unicode's categories of control characters, halves of characters, and ends of lines and paragraphs
        is_control = unicodedata.category(character) in ("Cc", "Cs", "Zl", "Zp")
        # Characters that turn the direction of writing, so that a text reads differently from what it is
        turns = 0x202A <= number <= 0x202E or 0x2066 <= number <= 0x2069 or number in (0x200E, 0x200F, 0x061C)
        if not is_control and not turns:
            written.append(character)
        elif number < 0x100:
            written.append(f"\\x{number:02x}")
        else:
            written.append(f"\\u{number:04x}")
    return "".join(written)


def in_html(text: object) -> str:
    """``text`` for a page or an SVG: no markup, and on one line (see :func:`escaped`)."""
    return html.escape(escaped(text))


def shell_argument(key: str, path: str | os.PathLike[str]) -> str:
    """``KEY=PATH`` as it can be pasted into a shell, whatever the path holds; relative if it lies well below here."""
    place, here = Path(path).absolute(), Path.cwd()
    below = str(place.relative_to(here)) if place.is_relative_to(here) else ""
    # a single word could be another value of the key, such as latest, and some characters begin more than a path
    return shlex.quote(f"{key}={below if below[:1].isalnum() and os.sep in below else place}")


def duration(seconds: float) -> str:
    """Hours, minutes and seconds."""
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{seconds:02}"


def figure(value: float, digits: int = 3) -> str:
    """A number with so many decimals; a dash if there is none."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"
