"""Ends of a process that are asked for from outside: signals, a terminal that goes away, a parent that dies."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

STOPPING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that ask for an end; Windows has no SIGHUP."""
PR_SET_PDEATHSIG = 1
"""Linux: signal that a process gets when its parent dies."""
_LIBC = ctypes.CDLL(None) if sys.platform.startswith("linux") else None  # loaded before any fork, which may not load


class Terminated(KeyboardInterrupt):
    """End by a signal. Whatever cleans up after Ctrl-C cleans up after all of them.

    Attributes:
        exit_code: 128 + the signal's number, as shells have it: 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP.
    """

    def __init__(self, number: int = signal.SIGINT) -> None:
        super().__init__(number)
        self.number = number
        self.exit_code = 128 + number


@dataclass
class Interrupt:
    """State of a block under `deferred_interrupts`.

    Attributes:
        number: The first signal that came; 0 before it.
    """

    number: int = 0

    @property
    def requested(self) -> bool:
        """True from the first signal on."""
        return self.number != 0


@contextmanager
def handled(handler: Callable[[int, FrameType | None], object], numbers: tuple[int, ...] = STOPPING) -> Iterator[None]:
    """Lets `handler` handle these signals inside the block; a signal that is ignored, as under nohup, stays so.

    The previous handlers are put back at the end. Outside the main thread, where Python delivers no signals, nothing
    is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    chosen = [number for number in numbers if signal.getsignal(number) is not signal.SIG_IGN]
    previous = {number: signal.signal(number, handler) for number in chosen}
    try:
        yield
    finally:
        for number, before in previous.items():
            signal.signal(number, before)


@contextmanager
def deferred_interrupts(
    on_first: Callable[[], object] = lambda: None, *, second_raises: bool = False
) -> Iterator[Interrupt]:
    """Records SIGINT, SIGTERM and SIGHUP inside the block instead of raising them, so that the work can stop at a safe
    place.

    Args:
        on_first: Called at the first signal, for example to print when the work will stop.
        second_raises: Raise `Terminated` at a second signal, if that is Ctrl-C; for work whose steps are long. Others
            may come twice without anyone's asking twice, as when a service stops all of its processes and one of them
            passes it on, or when a terminal is closed.
    """
    interrupt = Interrupt()

    def handle(number: int, frame: FrameType | None) -> None:
        if not interrupt.requested:
            interrupt.number = number
            on_first()
        elif second_raises and number == signal.SIGINT:
            raise Terminated(number)

    with handled(handle):
        yield interrupt


def die_with_parent() -> None:
    """Called in a child process: it is killed when its parent dies, however that dies. Linux alone can promise that."""
    if _LIBC is not None:
        parent = os.getppid()
        _LIBC.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it died in between
            os.kill(os.getpid(), signal.SIGKILL)


def stop_with_parent(parent: int, number: int) -> None:
    """Called in a child process: it gets a signal when its parent dies, so that it can still save. On Linux alone.

    Args:
        parent: Process id of the parent, which may have died already.
        number: The signal.
    """
    if _LIBC is not None:
        _LIBC.prctl(PR_SET_PDEATHSIG, number)
        if os.getppid() != parent:
            os.kill(os.getpid(), number)


def leave_signals_to_parent() -> None:
    """Called in the processes of a pool: Ctrl-C and a closed terminal reach every process, but the first one ends the
    others."""
    for number in STOPPING:
        signal.signal(number, signal.SIG_IGN)
    die_with_parent()
