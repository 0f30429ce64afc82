"""Interrupts that wait until a good moment."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

__all__ = ["Interrupt", "Terminated", "deferred_interrupts", "terminable"]

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Terminated(KeyboardInterrupt):
    """A request to end (SIGTERM, as schedulers of clusters send it before they kill): treated as Ctrl-C is."""


class Interrupt:
    """True once Ctrl-C or a request to end has arrived."""

    def __init__(self) -> None:
        self.number: int | None = None

    def __bool__(self) -> bool:
        return self.number is not None

    def stop(self) -> NoReturn:
        """Raise KeyboardInterrupt, or Terminated where it was a request to end."""
        raise Terminated if self.number == signal.SIGTERM else KeyboardInterrupt


@contextmanager
def deferred_interrupts() -> Iterator[Interrupt]:
    """Within the block the first interrupt only sets the flag; the second raises KeyboardInterrupt at once.

    Outside the main thread signals do not arrive and the flag stays False. A signal that the parent has asked to
    ignore (SIGINT in the background jobs of a shell script) stays ignored.
    """
    interrupt = Interrupt()

    def on_signal(number: int, frame: object) -> None:
        again = bool(interrupt)
        interrupt.number = number
        if again:
            interrupt.stop()

    with _handling(SIGNALS, on_signal):
        yield interrupt


@contextmanager
def terminable() -> Iterator[None]:
    """Within the block a request to end raises Terminated, so that nothing is left half done; as Ctrl-C does anyway."""

    def on_signal(number: int, frame: object) -> None:
        raise Terminated

    with _handling((signal.SIGTERM,), on_signal):
        yield


@contextmanager
def _handling(numbers: tuple[int, ...], handler: object) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard = [number for number in numbers if signal.getsignal(number) != signal.SIG_IGN]
    before = {number: signal.signal(number, handler) for number in heard}
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)
