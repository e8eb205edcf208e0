"""A gamepad, read from Linux' joystick interface (linux/joystick.h), so that it needs no package and no display.

| control | meaning |
|---|---|
| left stick forward | speed, from the slowest trained to the fastest |
| left stick back | backward, where that was trained |
| left stick let go | stand still |
| left stick to a side | turn |
| lower button (A, cross) | stand still |
| right button (B, circle) | start over |

The kernel numbers the left stick and these two buttons alike on every gamepad that it knows.
"""

from __future__ import annotations

import os
import stat
import struct
import sys
from pathlib import Path

from humoslope.deploy.steering import Steering
from humoslope.errors import UserError

DEVICES = Path("/dev/input")
EVENT = struct.Struct("=IhBB")
"""An event: time in ms, value, type, and number of the axis or button."""
BUTTON, AXIS, INITIAL = 0x01, 0x02, 0x80
"""Types of events; `INITIAL` is added to what is sent on opening, which no hand has done."""
SIDEWAYS, ALONG = 0, 1
"""Axes of the left stick, positive to the right and backward."""
LOWER, RIGHT = 0, 1
"""Numbers of buttons."""
FULL = 32767
"""Value of an axis at its end."""
DEAD_ZONE = 0.15
"""Share of the way of a stick around its middle that counts as the middle: worn sticks do not return exactly."""


class Gamepad:
    """An open gamepad.

    Args:
        path: Its device, such as /dev/input/js0.

    Raises:
        UserError: If there is none, or it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        if not sys.platform.startswith("linux"):
            raise UserError("--gamepad: gamepads are read on Linux only.")
        try:
            if not path.exists():
                there = ", ".join(map(str, sorted(DEVICES.glob("js*")))) or "none"
                raise UserError(f"there is no gamepad '{path}'; there are: {there}.")
            if stat.S_ISREG(path.stat().st_mode) or path.is_dir():
                raise UserError(f"'{path}' is no gamepad, but a file or folder.")
            self._device = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise UserError(f"gamepad '{path}' cannot be read: {error.strerror}.") from None
        self._rest = b""
        self._axes = {SIDEWAYS: 0.0, ALONG: 0.0}

    def steer(self, steering: Steering) -> bool:
        """Passes on what has been done with the gamepad since the last call; False if it is not there any more."""
        content, there = self._read()
        whole = len(content) - len(content) % EVENT.size
        self._rest = content[whole:]
        for _, value, kind, number in EVENT.iter_unpack(content[:whole]):
            if kind & ~INITIAL == AXIS and number in self._axes:
                before, self._axes[number] = self._axes[number], _beyond_dead_zone(value)
                # A resting stick jitters, and must not take the command from keys and sliders.
                if not kind & INITIAL and self._axes[number] != before:
                    steering.push(-self._axes[ALONG], -self._axes[SIDEWAYS])
            elif kind == BUTTON and value and number == LOWER:
                steering.stand()
            elif kind == BUTTON and value and number == RIGHT:
                steering.start_over()
        return there

    def close(self) -> None:
        """Closes the device."""
        os.close(self._device)

    def _read(self) -> tuple[bytes, bool]:
        """Everything that has not been read yet, and whether more may come."""
        content = self._rest
        while True:
            try:
                part = os.read(self._device, 64 * EVENT.size)
            except BlockingIOError:
                return content, True
            except OSError:  # it was unplugged
                return content, False
            if not part:
                return content, False
            content += part


def _beyond_dead_zone(value: int) -> float:
    """Place of a stick from -1 to 1, 0 within the dead zone, without a jump at its end."""
    way = min(abs(value) / FULL, 1.0)
    return 0.0 if way <= DEAD_ZONE else (way - DEAD_ZONE) / (1.0 - DEAD_ZONE) * (1.0 if value > 0 else -1.0)
