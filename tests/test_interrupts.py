"""SIGINT and SIGTERM are recorded while work is under way, and are what they were before afterwards."""

from __future__ import annotations

import signal
import threading

import pytest

from humoslope.interrupts import deferred_interrupts

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@pytest.fixture(autouse=True)
def previous_handlers():
    """Every test must leave the handlers as it found them."""
    before = [signal.getsignal(number) for number in SIGNALS]
    yield
    assert [signal.getsignal(number) for number in SIGNALS] == before


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_is_recorded_and_raises_nothing(number: signal.Signals) -> None:
    calls: list[str] = []
    with deferred_interrupts(lambda: calls.append("first")) as interrupt:
        assert not interrupt.requested
        signal.raise_signal(number)
        signal.raise_signal(number)
        assert interrupt.requested
    assert calls == ["first"]


@pytest.mark.parametrize("second", SIGNALS)
def test_a_second_signal_raises_where_it_is_asked_for(second: signal.Signals) -> None:
    with deferred_interrupts(second_raises=True) as interrupt:
        signal.raise_signal(signal.SIGINT)
        assert interrupt.requested
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(second)


def test_the_handlers_come_back_after_an_error() -> None:
    with pytest.raises(ZeroDivisionError), deferred_interrupts():
        _ = 1 / 0


def test_outside_the_main_thread_signals_are_left_alone() -> None:
    found: list[object] = []

    def work() -> None:
        with deferred_interrupts() as interrupt:
            found.extend([interrupt.requested, signal.getsignal(signal.SIGINT)])

    before = signal.getsignal(signal.SIGINT)
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [False, before]
