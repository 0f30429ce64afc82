"""Bounds for readers under test: an answer or an error of warpvox, within some seconds and little memory."""

from __future__ import annotations

import contextlib
import resource
import signal
import tracemalloc
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis.strategies import SearchStrategy

from warpvox.errors import WarpvoxError

SECONDS = 30
"""Of the processor, that one input may take; the slowest takes one."""
MEMORY = 64_000_000
"""Bytes that one input (none is longer than a few hundred kilobytes) may take, as Python and numpy take it."""
ADDRESSES = 2_000_000_000
"""Bytes of addresses that the process may take besides those that it has."""
TRACED = 10
"""The memory of one input in so many is traced, which is slow; all have the limit of addresses."""


@contextlib.contextmanager
def bounded(memory: int | None = MEMORY, seconds: float = SECONDS) -> Iterator[None]:
    """Fail if the block takes more than so many seconds, or bytes of memory (None: not traced)."""

    def stop(*_: object) -> None:
        pytest.fail(f"took more than {seconds} s")

    before = signal.signal(signal.SIGPROF, stop), resource.getrlimit(resource.RLIMIT_AS)
    taken = Path("/proc/self/statm")
    if taken.exists():
        limit = int(taken.read_text().split()[0]) * resource.getpagesize() + ADDRESSES
        resource.setrlimit(resource.RLIMIT_AS, (limit, before[1][1]))
    signal.setitimer(signal.ITIMER_PROF, seconds)  # of this process alone: a shared machine may stall
    if memory is not None:
        tracemalloc.start()
    try:
        yield
        assert memory is None or tracemalloc.get_traced_memory()[1] < memory, "took too much memory"
    finally:
        tracemalloc.stop()
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before[0])
        resource.setrlimit(resource.RLIMIT_AS, before[1])


def check_error(error: BaseException) -> None:
    """An error of ours says something, at a length that one can read, and does not hide that memory ran out."""
    assert 0 < len(str(error).strip()) < 50_000
    cause: BaseException | None = error
    while cause is not None:
        assert not isinstance(cause, MemoryError)
        cause = cause.__cause__ or cause.__context__


def refused(read: Callable[[], object], error: type[WarpvoxError], words: str) -> None:
    """``read`` raises ``error`` with these words, soon, and with little memory."""
    with bounded(), pytest.raises(error, match=words) as caught:
        read()
    check_error(caught.value)


def fuzz(
    inputs: SearchStrategy, use: Callable[[Any], None], share: float = 1.0, allowed: tuple[type[Exception], ...] = ()
) -> None:
    """Give ``use`` many inputs: each is of use, or refused with an error of ours, and some are refused.

    Args:
        inputs: what to draw from.
        use: reads an input, and uses what it accepts.
        share: of the profile's number of examples, less where one takes long.
        allowed: other errors that a function promises.
    """
    outcomes: Counter[str] = Counter()

    @settings(max_examples=max(5, int(share * settings.default.max_examples)))
    @given(inputs)
    def one(value: Any) -> None:
        with bounded(None if outcomes.total() % TRACED else MEMORY), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                use(value)
                outcomes["accepted"] += 1
            except (WarpvoxError, *allowed) as error:
                outcomes["refused"] += 1
                check_error(error)

    one()
    print(dict(outcomes))
    assert outcomes["refused"] > outcomes.total() / 10  # else nothing was damaged, or nothing looks at it
