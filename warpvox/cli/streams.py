"""Output that outlives its reader, fits every encoding, and is never another file.

Three things can be wrong with the standard streams of a command that works for hours. Their reader goes away
(``| head`` has seen enough, the window or the connection of the terminal is closed). Their encoding lacks letters that
are printed (cp1252, ASCII). Or they were closed from the start (``>&-``), and the next file that is opened takes their
number.
"""

from __future__ import annotations

import codecs
import errno
import os
import sys
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

__all__ = ["lasting_output", "redirect"]

GONE = {errno.EPIPE, errno.ECONNRESET, errno.ESHUTDOWN}
"""What writing to a pipe or socket says whose reader has gone."""
OF_TERMINALS = {errno.EIO, errno.ENXIO, errno.EBADF}
"""What writing to a terminal says that was closed; of a file it would mean that the disk has failed."""
SUBSTITUTES = {"θ": "theta", "Δ": "d", "°": " deg", "·": "-", "…": "...", "×": "x", "±": "+-", "≤": "<=", "≥": ">="}
"""How letters are written where the encoding has none of them."""


class _Lasting:
    """A text stream that discards output once its reader has gone; until then the stream that it wraps."""

    def __init__(self, stream: Any, told: str | None = None) -> None:
        self._stream, self._told, self._silent = stream, told, False
        self._terminal = stream.isatty()  # once it has been closed a terminal does not say so any more

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        if not self._silent:
            self._try(self._stream.write, _fitted(text, getattr(self._stream, "encoding", None)))
        return len(text)

    def writelines(self, lines: Any) -> None:
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        if not self._silent:
            self._try(self._stream.flush)

    def _try(self, function: Any, *words: Any) -> None:
        try:
            function(*words)
        except OSError as error:
            if error.errno not in GONE and not (error.errno in OF_TERMINALS and self._terminal):
                raise
            self._silent = True
            redirect(self._stream)
            if self._told:
                print(self._told, file=sys.stderr)


@contextmanager
def lasting_output(told: str | None = None) -> Iterator[None]:
    """Within the block standard output and errors outlive their readers.

    Args:
        told: a line that is written to standard error when the reader of standard output has gone.
    """
    _open_closed()
    before = sys.stdout, sys.stderr
    sys.stdout = wrapped = _Lasting(before[0] or _nowhere(), told)
    sys.stderr = wrapped_errors = _Lasting(before[1] or _nowhere())
    try:
        yield
    finally:
        # somebody else may have put his own stream there meanwhile
        if sys.stdout is wrapped:
            sys.stdout = before[0]
        if sys.stderr is wrapped_errors:
            sys.stderr = before[1]


def _open_closed() -> None:
    """Give standard streams that were closed (``>&-``) to the null device, lest the next file gets their number."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            with suppress(OSError):
                os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free: this one


def _nowhere() -> Any:
    return open(os.devnull, "w", encoding="utf-8")


def redirect(stream: Any) -> None:
    """Send what is left in a stream's buffers to the null device; Python would complain at its exit."""
    with suppress(OSError, ValueError, AttributeError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


# ------------------------------------------------------------------------------------------------------- encodings


def _fitted(text: str, encoding: str | None) -> str:
    """``text`` with substitutes for what an encoding lacks."""
    if not encoding or text.isascii() or encoding.lower().startswith(("utf", "u8")):
        return text
    try:
        return text.encode(encoding, "warpvox.substitute").decode(encoding)
    except LookupError:
        return text


def _substitute(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_plain, error.object[error.start : error.end])), error.end


def _plain(letter: str) -> str:
    """A letter in ASCII: what stands for it, itself without its accents, or a question mark."""
    bare = unicodedata.normalize("NFKD", letter).encode("ascii", "ignore").decode()
    return SUBSTITUTES.get(letter) or bare or "?"


codecs.register_error("warpvox.substitute", _substitute)
