"""Interrupts that wait, and those that the parent process ignores."""

import signal
from collections.abc import Iterator

import pytest

from warpvox.algos.interrupt import Terminated, deferred_interrupts, terminable, uninterrupted
from warpvox.system import stop_signals

SIGNALS = (signal.SIGINT, *stop_signals())


@pytest.fixture
def ignored() -> Iterator[None]:
    before = {number: signal.signal(number, signal.SIG_IGN) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_one_waits_and_the_second_does_not(number: int) -> None:
    before = signal.getsignal(number)
    with deferred_interrupts() as interrupt:
        signal.raise_signal(number)
        assert interrupt
        with pytest.raises(KeyboardInterrupt) as raised:
            signal.raise_signal(number)
    assert isinstance(raised.value, Terminated) == (number == signal.SIGTERM)
    assert signal.getsignal(number) is before


def test_a_block_that_cannot_be_interrupted_ends_first() -> None:
    ended = []
    with pytest.raises(Terminated), terminable(), uninterrupted():
        signal.raise_signal(signal.SIGTERM)
        ended.append(True)
        raise ValueError("comes second to the request to end")
    assert ended


@pytest.mark.usefixtures("ignored")
@pytest.mark.parametrize("number", SIGNALS)
def test_what_the_parent_ignores_stays_ignored(number: int) -> None:
    with deferred_interrupts() as interrupt, terminable():
        signal.raise_signal(number)
        signal.raise_signal(number)
    assert not interrupt
    assert signal.getsignal(number) is signal.SIG_IGN
