"""What a person asks for, with the remote control or the keyboard: requests, and the command of the policy."""

from __future__ import annotations

import math

import numpy as np

from humoslope.deploy import rotation
from humoslope.deploy.contract import Commands, Range, Steering
from humoslope.deploy.onboard.messages import Remote
from humoslope.deploy.onboard.states import Request
from humoslope.deploy.quantities import Array

STEP = 0.1
"""Change of the command by one key press, m/s or rad/s."""
DEAD = 0.05
"""Deflection of a stick below which it counts as released."""
BUTTON_REQUESTS = {"start": Request.START, "A": Request.WALK, "select": Request.STOP}
"""Requests by single buttons; L2 with B asks to stop, too."""
KEY_REQUESTS = {"s": Request.START, "w": Request.WALK, " ": Request.STOP, "q": Request.STOP}
KEYS = "s: start; w: walk; up, down: speed; left, right: turn; 0: stand; space or q: stop"


class Pilot:
    """Requests and command of a person, from what the remote control shows and from key presses.

    A deflected stick has the command; once released it means zero, a command to stand. Keys change a command that
    stays, and that the first deflection of a stick ends.

    Args:
        commands: Commands that the policy was trained with; everything is kept within their ranges.
        speed: Forward speed that is commanded until a stick or a key says otherwise, m/s.
    """

    def __init__(self, commands: Commands, speed: float = 0.0) -> None:
        self._commands = commands
        self._kept = np.array([speed, 0.0, 0.0])
        self._before: frozenset[str] = frozenset()
        self._keys: list[str] = []

    def press(self, key: str) -> None:
        """Takes a key press: one of `KEYS`, or "up", "down", "left", "right"; others are ignored."""
        self._keys.append(key)

    def requests(self, remote: Remote) -> frozenset[Request]:
        """Returns the requests since the last call. A button counts when it is pressed, not while it is."""
        new, self._before = remote.buttons - self._before, remote.buttons
        asked = {BUTTON_REQUESTS[name] for name in new if name in BUTTON_REQUESTS}
        if {"L2", "B"} <= remote.buttons:
            asked.add(Request.STOP)
        for key in self._keys:
            if key in KEY_REQUESTS:
                asked.add(KEY_REQUESTS[key])
            self._change(key)
        self._keys.clear()
        return frozenset(asked)

    def command(self, remote: Remote) -> Array:
        """Returns the command [3]: forward and left speed, m/s, and yaw rate, rad/s."""
        ranges = (self._commands.forward_m_s, self._commands.left_m_s, self._commands.yaw_rate_rad_s)
        sticks = (remote.forward, remote.left, remote.turn)
        if any(abs(stick) > DEAD for stick in sticks):
            self._kept[:] = 0.0
            return np.array([_scaled(stick, limits) for stick, limits in zip(sticks, ranges, strict=True)])
        return np.array([_within(value, limits) for value, limits in zip(self._kept, ranges, strict=True)])

    def _change(self, key: str) -> None:
        changes: dict[str, tuple[int, float]] = {
            "up": (0, STEP), "down": (0, -STEP), "left": (2, STEP), "right": (2, -STEP)
        }  # fmt: skip
        if key == "0":
            self._kept[:] = 0.0
        elif key in changes:
            axis, change = changes[key]
            limits = (self._commands.forward_m_s, self._commands.left_m_s, self._commands.yaw_rate_rad_s)[axis]
            self._kept[axis] = round(_within(self._kept[axis] + change, limits), 6)


class Heading:
    """An outer loop that holds the heading while no turn is commanded, by the contract's law without its place.

    Args:
        steering: Gain and limit of the law.
    """

    def __init__(self, steering: Steering) -> None:
        self._steering = steering
        self._kept: float | None = None

    def __call__(self, command: Array, quat_w: Array) -> Array:
        """Returns the command [3] with the yaw rate that leads back to the kept heading; a command to stand or to turn
        is left alone, and ends with a new heading."""
        yaw = float(rotation.yaw(quat_w))
        if command[2] or not command.any():
            self._kept = None
            return command
        if self._kept is None:
            self._kept = yaw
        error = math.remainder(self._kept - yaw, 2.0 * math.pi)
        limit = self._steering.limit_rad_s
        rate = max(-limit, min(limit, self._steering.heading_gain_per_s * error))
        return np.array([command[0], command[1], rate])


def _scaled(stick: float, limits: Range) -> float:
    """A stick's full deflection is the end of the range; what lies beyond the range's sign is zero."""
    if abs(stick) <= DEAD:
        return 0.0
    return max(0.0, limits[1]) * min(stick, 1.0) if stick > 0.0 else min(0.0, limits[0]) * min(-stick, 1.0)


def _within(value: float, limits: Range) -> float:
    """The ranges are widened to zero: a released stick is a command to stand."""
    return float(min(max(value, min(limits[0], 0.0)), max(limits[1], 0.0)))
