"""Feeds spoilt inputs to a reader and judges what comes back: an answer, or an error of ours, in time and in bounds."""

from __future__ import annotations

import contextlib
import random
import resource
import signal
import time
import traceback
import tracemalloc
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from warpvox.errors import WarpvoxError

SECONDS = 10.0
"""Of processor time that one input may take; by far the slowest takes a fraction of it."""
PATIENCE = 120.0
"""Seconds on the clock that it may take: a machine may have other things to do."""
MEGABYTES = 64
"""Of memory that one input (none is longer than a few hundred kilobytes) may take, as Python and numpy take it."""
TRACED = 10
"""Of so many inputs the memory of one is traced, which takes as long as reading it. All of them have a limit."""
ADDRESSES = 2_000_000_000
"""Bytes of addresses that the process may take besides those that it has when it begins with a target."""


class TooSlow(BaseException):
    """An input that takes for ever. Not an Exception, so that nobody on the way takes it for a damaged file."""


@dataclass(frozen=True)
class Target:
    """A reader or a public function under test.

    Attributes:
        name: of the row in the table.
        make: draws an input.
        run: gives it to the reader, and uses what the reader accepts.
        allowed: errors besides those of ours that the function promises, for instance of the drop-in.
        weight: share of the inputs, against the others.
    """

    name: str
    make: Callable[[random.Random], Any]
    run: Callable[[Any], None]
    allowed: tuple[type[Exception], ...] = ()
    weight: int = 10


@dataclass
class Figures:
    """What became of the inputs of a target."""

    inputs: int = 0
    accepted: int = 0
    refused: int = 0
    slowest: float = 0.0
    peak: int = 0
    defects: list[tuple[Any, str]] = field(default_factory=list)


@contextlib.contextmanager
def within(seconds: float) -> Iterator[None]:
    """Raise :class:`TooSlow` in the block after so many seconds of the processor, or :data:`PATIENCE` on the clock."""

    def stop(*_: object) -> None:
        raise TooSlow

    before = [signal.signal(number, stop) for number in (signal.SIGPROF, signal.SIGALRM)]
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in zip((signal.SIGPROF, signal.SIGALRM), before, strict=True):
            signal.signal(number, handler)


@contextlib.contextmanager
def bounded(more: int = ADDRESSES) -> Iterator[None]:
    """Let the process take so many bytes of addresses more, and not a byte beyond; where the system can say."""
    status = Path("/proc/self/statm")
    if not status.exists():
        yield
        return
    before = resource.getrlimit(resource.RLIMIT_AS)
    taken = int(status.read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + more, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


@contextlib.contextmanager
def traced(figures: Figures) -> Iterator[Callable[[], int]]:
    """Every so often the memory that is taken in the block: a function that gives the most of it in bytes, else 0."""
    if figures.inputs % TRACED:
        yield lambda: 0
        return
    tracemalloc.start()
    try:
        yield lambda: tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def judge(target: Target, given: Any, figures: Figures) -> None:
    """Run one input and note what became of it; everything but an answer or an error of ours is a defect."""
    with traced(figures) as peak:
        defect = _outcome(target, given, figures)
        figures.peak = max(figures.peak, peak())
        if peak() > MEGABYTES * 1e6:
            defect = f"took {peak() / 1e6:.0f} MB of memory"
    figures.inputs += 1
    if defect is not None:
        figures.defects.append((given, defect))


def _outcome(target: Target, given: Any, figures: Figures) -> str | None:
    defect = None
    start = time.process_time()
    try:
        with within(SECONDS), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            target.run(given)
        figures.accepted += 1
    except TooSlow:
        defect = f"took more than {SECONDS:g} s of the processor, or {PATIENCE:g} s"
    except (WarpvoxError, *target.allowed) as error:
        figures.refused += 1
        defect = objection(error)
    except Exception:
        defect = traceback.format_exc(limit=-6)
    figures.slowest = max(figures.slowest, time.process_time() - start)
    return defect


def objection(error: Exception) -> str | None:
    """What is wrong with an error of ours: it says nothing, or far too much, or hides that memory ran out."""
    text = str(error)
    if not text.strip():
        return f"{type(error).__name__} without a message"
    if len(text) > 50_000:
        return f"{type(error).__name__} of {len(text)} characters"
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, MemoryError):
            return "memory ran out: " + traceback.format_exc(limit=-6)
        cause = cause.__cause__ or cause.__context__
    return None


def feed(target: Target, count: int, seed: int, most_defects: int = 5) -> Figures:
    """Judge ``count`` inputs; each draws from a generator of its own, so that one can be made again alone."""
    figures = Figures()
    with bounded():
        for number in range(count):
            judge(target, make(target, number, seed), figures)
            if len(figures.defects) >= most_defects:
                break
    return figures


def make(target: Target, number: int, seed: int) -> Any:
    """Input ``number`` of a target."""
    return target.make(random.Random(f"{seed} {target.name} {number}"))


def shortened(given: Any, length: int = 300) -> str:
    """An input for a report."""
    text = repr(given)
    return text if len(text) <= length else f"{text[:length]}... ({len(text)} characters)"
