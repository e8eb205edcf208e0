"""Stopping long work between two of its steps, on Ctrl-C or on SIGTERM."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType


@dataclass
class Interrupt:
    """State of a block under `deferred_interrupts`.

    Attributes:
        requested: True from the first SIGINT or SIGTERM on.
    """

    requested: bool = False


@contextmanager
def deferred_interrupts(
    on_first: Callable[[], object] = lambda: None, *, second_raises: bool = False
) -> Iterator[Interrupt]:
    """Records SIGINT and SIGTERM inside the block instead of raising them, so that the work can stop at a safe place.

    The previous handlers are put back at the end. Outside the main thread, where Python delivers no signals, nothing
    is changed.

    Args:
        on_first: Called at the first signal, for example to print when the work will stop.
        second_raises: Raise KeyboardInterrupt at the second signal; for work whose steps are long.
    """
    interrupt = Interrupt()
    if threading.current_thread() is not threading.main_thread():
        yield interrupt
        return

    def handle(number: int, frame: FrameType | None) -> None:
        if not interrupt.requested:
            interrupt.requested = True
            on_first()
        elif second_raises:
            raise KeyboardInterrupt

    previous = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield interrupt
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
