"""Standard output that survives a closed pipe (``| head``), a closed terminal and a closed stream (``>&-``)."""

import errno
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from warpvox.system import GONE


class _SurvivingStream:
    """Text stream that switches to the null device when its pipe or terminal is closed."""

    def __init__(self, stream: Any, message: str | None = None) -> None:
        self._stream = stream
        self._message = message
        self._gone = GONE
        if stream.isatty():
            # A closed terminal gives these errors; with a file they mean that the disk has failed.
            self._gone = GONE | {errno.EIO, errno.ENXIO, errno.EBADF}

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the wrapped stream."""
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        self._call(self._stream.write, text)
        return len(text)

    def writelines(self, lines: Any) -> None:
        self.write("".join(lines))

    def flush(self) -> None:
        self._call(self._stream.flush)

    def _call(self, function: Any, *words: Any) -> None:
        """Call a method of the wrapped stream; switch to the null device if the pipe is closed."""
        try:
            function(*words)
        except OSError as error:
            if error.errno not in self._gone:
                raise
            redirect(self._stream)
            if self._message:
                print(self._message, file=sys.stderr)


@contextmanager
def lasting_output(message: str | None = None) -> Iterator[None]:
    """Keep standard output and errors usable within the block if the pipe or terminal is closed.

    Args:
        message: a line that is written to standard error when the reader of standard output has gone.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) < 3:
        pass  # the null device replaces a standard stream that is closed
    os.close(number)
    before = sys.stdout, sys.stderr
    for stream in before:
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    nowhere = open(os.devnull, "w")  # noqa: SIM115
    ours = _SurvivingStream(before[0] or nowhere, message), _SurvivingStream(before[1] or nowhere)
    sys.stdout, sys.stderr = ours
    try:
        yield
    finally:
        # restore only our own streams: others may have been set meanwhile
        sys.stdout = before[0] if sys.stdout is ours[0] else sys.stdout
        sys.stderr = before[1] if sys.stderr is ours[1] else sys.stderr


def redirect(stream: Any) -> None:
    """Discard the buffered text of a closed stream, so that Python does not complain at exit."""
    with suppress(OSError, ValueError, AttributeError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
