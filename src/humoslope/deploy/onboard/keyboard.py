"""Key presses from a terminal, without waiting for them."""

from __future__ import annotations

import contextlib
import os
import select
import sys
from collections.abc import Iterator
from types import ModuleType

ARROWS = {"\x1b[A": "up", "\x1b[B": "down", "\x1b[C": "right", "\x1b[D": "left"}


class Keyboard:
    """The keys that were pressed since the last look; none if the input is no terminal."""

    def __init__(self, descriptor: int | None) -> None:
        self._descriptor = descriptor

    def pressed(self) -> list[str]:
        """Returns the keys, the arrows as "up", "down", "left" and "right"."""
        if self._descriptor is None or not select.select([self._descriptor], [], [], 0.0)[0]:
            return []
        text = os.read(self._descriptor, 64).decode("utf-8", "replace")
        keys = []
        while text:
            arrow = next((sequence for sequence in ARROWS if text.startswith(sequence)), None)
            keys.append(ARROWS[arrow] if arrow else text[0])
            text = text[len(arrow or text[0]) :]
        return keys


@contextlib.contextmanager
def keyboard() -> Iterator[Keyboard]:
    """Reads single keys inside the block, without echo; the terminal is put back at the end."""
    termios = _termios()
    if termios is None or not sys.stdin.isatty():
        yield Keyboard(None)
        return
    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    quiet = termios.tcgetattr(descriptor)
    quiet[3] &= ~(termios.ICANON | termios.ECHO)
    try:
        termios.tcsetattr(descriptor, termios.TCSANOW, quiet)
        yield Keyboard(descriptor)
    finally:
        termios.tcsetattr(descriptor, termios.TCSANOW, before)


def _termios() -> ModuleType | None:
    try:
        import termios
    except ImportError:  # Windows
        return None
    return termios
