"""Interrupts that wait until a good moment."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["Interrupt", "deferred_interrupts"]

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupt:
    """True once Ctrl-C (or a termination request) has arrived."""

    def __init__(self) -> None:
        self.requested = False

    def __bool__(self) -> bool:
        return self.requested


@contextmanager
def deferred_interrupts() -> Iterator[Interrupt]:
    """Within the block the first interrupt only sets the flag; the second raises KeyboardInterrupt at once.

    Outside the main thread signals do not arrive and the flag stays False.
    """
    interrupt = Interrupt()
    if threading.current_thread() is not threading.main_thread():
        yield interrupt
        return

    def on_signal(number: int, frame: object) -> None:
        if interrupt.requested:
            raise KeyboardInterrupt
        interrupt.requested = True

    before = {number: signal.signal(number, on_signal) for number in SIGNALS}
    try:
        yield interrupt
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
