"""Exceptions of warpvox, and helpers for error messages.

Every error that a user can cause derives from :class:`WarpvoxError`, so that the command line can turn it
into one clear line and exit code 2, while anything else stays a traceback (a defect of ours). Each class also
derives from the builtin that generic code expects (``ValueError`` for bad input, ``RuntimeError`` for a bad
machine or state).

A message says what was expected, what was given, which values are valid and which of them is nearest.
"""

import difflib
from collections.abc import Iterable
from pathlib import Path
from typing import Any


class WarpvoxError(Exception):
    """Base of all errors that warpvox raises on purpose."""


class DesignError(WarpvoxError, ValueError):
    """A robot body is not valid (empty, not connected, without actuator, ...) or cannot be read."""


class WorldError(WarpvoxError, ValueError):
    """A world is not valid: overlap, negative position, duplicate or unknown object, unreadable file."""


class TaskError(WarpvoxError, ValueError):
    """An unknown task id, or a task used in a way that its specification does not allow."""


class ActionError(WarpvoxError, ValueError):
    """Actions of the wrong shape or type, or with entries that are not finite."""


class ConfigError(WarpvoxError, ValueError):
    """An unknown configuration key, or a value outside of what the key allows."""


class UnknownArgumentError(ConfigError, TypeError):
    """An unknown keyword argument; also a TypeError, so that other libraries recognise it."""


class StoredCodeError(ConfigError):
    """A file names the user's own code; it is imported only if the user passes its key again.

    Attributes:
        key: such as ``task``.
        text: the code as the file names it.
        place: of the file, or its folder.
    """

    def __init__(self, key: str, text: str, place: object) -> None:
        super().__init__(key, text, place)
        self.key = key
        self.text = text
        self.place = place

    def __str__(self) -> str:
        return (
            f"{self.place} names code, {self.key}={self.text!r:.200}, which is imported only if you name it yourself:"
            f" {self.key}=FILE.py:NAME."
        )


class RunError(WarpvoxError, ValueError):
    """A folder that is not a run of warpvox, or a run that lacks what is needed."""


class ResumeError(RunError):
    """A run cannot continue as asked, but could from another checkpoint or with other settings.

    Attributes:
        resume: the folder or checkpoint to go on from.
        changes: settings by name that let it go on.
    """

    def __init__(self, message: str, resume: Path, **changes: Any) -> None:
        super().__init__(message)
        self.resume = resume
        self.changes = changes


class DivergenceError(RunError):
    """Training produced NaN or infinity; usually the learning rate is too high."""


class RolloutError(WarpvoxError, ValueError):
    """A recorded rollout that cannot be read, written or exported."""


class DeviceError(WarpvoxError, RuntimeError):
    """A compute device that does not exist on this machine or cannot be used."""


class MemoryLimitError(DeviceError):
    """A request for more than the free memory holds; the message says what fits."""


class StorageError(WarpvoxError, OSError):
    """A disk is full, read-only or gone, or a folder vanished while it was being written to.

    ``errno`` and ``strerror`` are those of the system's own error.
    """

    def __init__(self, message: str, cause: OSError | None = None) -> None:
        super().__init__(message)
        if cause is not None:
            self.errno = cause.errno
            self.strerror = cause.strerror

    def __str__(self) -> str:
        return str(self.args[0])  # OSError's own form would hide the sentence behind a number


class DisplayError(WarpvoxError, RuntimeError):
    """A window was requested on a machine that cannot show one."""


class SearchError(WarpvoxError, RuntimeError):
    """A design search was called in the wrong order or with unusable values, or has no new designs left."""


class SimulationError(WarpvoxError, RuntimeError):
    """The simulator cannot do what was asked in its present state."""


def did_you_mean(name: object, options: Iterable[object]) -> str:
    """Return ``" Did you mean 'X'?"`` for the option nearest to ``name``, or ``""`` if none is near.

    The leading blank lets a caller append the result to a finished sentence. Letter case, the most common slip, is
    ignored, and so is the ending ``-v0``, by which all tasks are alike.
    """
    by_folded = {str(option).casefold().removesuffix("-v0"): str(option) for option in options}
    near = difflib.get_close_matches(str(name).casefold().removesuffix("-v0"), by_folded, n=1, cutoff=0.6)
    return f" Did you mean '{by_folded[near[0]]}'?" if near else ""


def first_line(error: Exception) -> str:
    """Return the first line of an exception's message, or the exception's type if it has none."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def listing(options: Iterable[object], limit: int = 12) -> str:
    """Join options as ``"a, b, c"``, cut after ``limit`` entries (``"a, b, ... (30 more)"``).

    An empty collection gives ``"(none)"``, so that a sentence built from it stays a sentence.
    """
    names = [str(option) for option in options]
    left = len(names) - limit
    return ", ".join(names[:limit] or ["(none)"]) + (f", ... ({left} more)" if left > 0 else "")


def counted(number: int, things: str) -> str:
    """Format a number with a singular or plural noun: ``3 designs`` or ``1 design``."""
    return f"{number:,} {things.removesuffix('s') if number == 1 else things}"
