"""SIGINT, SIGTERM and SIGHUP are recorded while work is under way, and are what they were before afterwards."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from humoslope.interrupts import Terminated, deferred_interrupts

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


PATIENCE = 6000
"""Looks at a child before the test gives up on it; no result depends on it."""


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
        assert interrupt.number == number
    assert calls == ["first"]


@pytest.mark.parametrize("first", SIGNALS)
def test_a_second_ctrl_c_raises_where_it_is_asked_for(first: signal.Signals) -> None:
    with deferred_interrupts(second_raises=True) as interrupt:
        signal.raise_signal(first)
        assert interrupt.requested
        with pytest.raises(Terminated) as stop:
            signal.raise_signal(signal.SIGINT)
        assert stop.value.exit_code == 128 + signal.SIGINT


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_one_stop_that_arrives_as_two_signals_is_one_stop(number: signal.Signals) -> None:
    with deferred_interrupts(second_raises=True) as interrupt:
        signal.raise_signal(number)
        signal.raise_signal(number)
        assert interrupt.number == number


def test_a_signal_that_is_ignored_as_under_nohup_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with deferred_interrupts() as interrupt:
            signal.raise_signal(signal.SIGHUP)
            assert not interrupt.requested
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_child_does_not_outlive_a_parent_that_is_killed() -> None:
    code = (
        "import subprocess, sys, time; from humoslope.interrupts import die_with_parent;"
        "c = subprocess.Popen(['sleep', '600'], preexec_fn=die_with_parent); print(c.pid, flush=True); time.sleep(600)"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    for _ in range(PATIENCE):
        if not Path(f"/proc/{child}").exists() or "Z" in Path(f"/proc/{child}/stat").read_text().split()[2]:
            break
        time.sleep(0.01)
    else:
        os.kill(child, signal.SIGKILL)
        pytest.fail("the child lives on")


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
