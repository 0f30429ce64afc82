"""Untrusted text made safe to show: without control characters and markup."""

import html
import math
import os
import shlex
import unicodedata
from pathlib import Path


def shown(path: Path) -> str:
    """Format ``path`` for a message: relative to the current folder if that is shorter."""
    try:
        relative = os.path.relpath(path)
    except ValueError:  # another drive of Windows
        return str(path)
    return relative if len(relative) < len(str(path)) else str(path)


def escaped(text: object) -> str:
    """Replace control characters in ``text``, such as escapes and line ends, by codes: ``\\x1b``."""
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
    """Escape ``text`` for HTML or SVG, on one line."""
    return html.escape(escaped(text))


def shell_argument(key: str, path: str | os.PathLike[str]) -> str:
    """Quote ``KEY=PATH`` for a shell; a path in a subfolder of the current folder becomes relative."""
    place = Path(path).absolute()
    here = Path.cwd()
    below = str(place.relative_to(here)) if place.is_relative_to(here) else ""
    # a single word could be another value of the key, such as latest, and some characters begin more than a path
    return shlex.quote(f"{key}={below if below[:1].isalnum() and os.sep in below else place}")


def duration(seconds: float) -> str:
    """Format ``seconds`` as ``H:MM:SS``, rounded."""
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{seconds:02}"


def figure(value: float, digits: int = 3) -> str:
    """Format ``value`` with ``digits`` decimals; a dash for NaN and infinity."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"
