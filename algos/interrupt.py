"""Handling of Ctrl-C and termination signals: defer them to a safe moment."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

from warpvox.system import HANGUP, stop_signals


class Terminated(KeyboardInterrupt):
    """KeyboardInterrupt for a termination signal, handled like Ctrl-C.

    SIGTERM, as schedulers of clusters send it before they kill; SIGHUP, when the window or connection is closed.
    ``number`` is the signal's.
    """

    def __init__(self, number: int = signal.SIGTERM) -> None:
        super().__init__(number)
        self.number = int(number)


class Interrupt:
    """Flag set by Ctrl-C or a termination signal; ``number`` is the signal."""

    def __init__(self) -> None:
        self.number: int | None = None

    def __bool__(self) -> bool:
        """Return whether an interrupt has arrived."""
        return self.number is not None

    def raise_interrupt(self) -> NoReturn:
        """Raise KeyboardInterrupt, or Terminated after a termination signal."""
        raise KeyboardInterrupt if self.number in (None, signal.SIGINT) else Terminated(self.number)


@contextmanager
def deferred_interrupts() -> Iterator[Interrupt]:
    """Defer the first interrupt within the block: it sets the yielded flag; a second one raises at once.

    SIGHUP is never the first or second of two: a terminal that closes sends it more than once, from the shell and from
    the kernel, and nobody is there who could mean by it that things should be left as they are.

    Outside the main thread signals do not arrive and the flag stays False. A signal that the parent has asked to
    ignore (SIGINT in the background jobs of a shell script) stays ignored.
    """
    interrupt = Interrupt()

    def on_signal(number: int, frame: object) -> None:
        again = HANGUP not in (number, interrupt.number) and bool(interrupt)
        if interrupt.number in (None, HANGUP) or again:
            interrupt.number = number
        if again:
            interrupt.raise_interrupt()

    with _with_handler((signal.SIGINT, *stop_signals()), on_signal):
        yield interrupt


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Defer interrupts to the end of the block or the decorated function.

    For code of libraries whose own clean-up fails when it is interrupted, and which is done within a second.
    """
    with deferred_interrupts() as interrupt:
        try:
            yield
        finally:
            if interrupt:
                interrupt.raise_interrupt()


@contextmanager
def terminable() -> Iterator[None]:
    """Raise Terminated on termination signals within the block, so that clean-up runs as after Ctrl-C."""

    def on_signal(number: int, frame: object) -> None:
        raise Terminated(number)

    with _with_handler(stop_signals(), on_signal):
        yield


@contextmanager
def _with_handler(
    numbers: Sequence[int | None], handler: Callable[[int, Any], object] | signal.Handlers
) -> Iterator[None]:
    """Install ``handler`` for the signals ``numbers`` within the block, except ignored and unsupported ones.

    Outside the main thread, where signals do not arrive, nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard = [number for number in numbers if number is not None and signal.getsignal(number) != signal.SIG_IGN]
    before = {number: signal.signal(number, handler) for number in heard}
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)
