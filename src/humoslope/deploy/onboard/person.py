"""The person beside a simulated robot, who presses buttons and handles the gantry by a script."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from humoslope.deploy.onboard.simulated import SimulatedRobot
from humoslope.deploy.onboard.unitree_g1 import BUTTONS
from humoslope.errors import UserError, unknown

PRESSED_S = 0.2
"""Time for which a button is pressed, s."""
ASKED_S = 1.0
"""Time between two presses of start by a person who waits for the first command to the motors, s."""
STICKS = ("forward", "left", "turn")
GANTRY = ("lower", "release")


class Person:
    """Acts on a robot at the times of a script.

    Args:
        script: Actions such as "1:start 5:lower 8:forward=0.6", each with its time in s.
        waits: Press start again and again until the motors are first commanded, and count the time from there.

    Raises:
        UserError: If the script cannot be read.
    """

    def __init__(self, script: str, waits: bool = False) -> None:
        self._actions = sorted((_action(part) for part in script.split()), key=lambda action: action[0])
        self._begun: float | None = None if waits else 0.0
        self._asked = -ASKED_S
        self._pressed: list[tuple[float, str]] = []  # until when, and what

    def act(self, robot: SimulatedRobot) -> None:
        """Does what is due."""
        remote = robot.remote
        if self._begun is None and robot.commands:
            self._begun = robot.time
            self._pressed.clear()
        elif self._begun is None and robot.time >= self._asked + ASKED_S:
            self._asked = robot.time
            self._pressed.append((robot.time + PRESSED_S, "start"))
        now = -1.0 if self._begun is None else robot.time - self._begun
        while self._actions and now >= self._actions[0][0]:
            _, what, value = self._actions.pop(0)
            if what == "lower":
                robot.lower()
            elif what == "release":
                robot.release()
            elif what in STICKS:
                moved: dict[str, Any] = {what: value}
                remote = dataclasses.replace(remote, **moved)
            else:
                self._pressed.append((robot.time + PRESSED_S, what))
        self._pressed = [(until, what) for until, what in self._pressed if robot.time < until]
        robot.remote = dataclasses.replace(remote, buttons=frozenset(what for _, what in self._pressed))


def _action(part: str) -> tuple[float, str, float]:
    time, colon, what = part.partition(":")
    name, equals, value = what.partition("=")
    try:
        at, number = float(time), float(value) if equals else 0.0
    except ValueError:
        at = number = math.nan
    if not colon or not math.isfinite(at) or not math.isfinite(number) or bool(equals) != (name in STICKS):
        raise UserError(f"script: '{part}' must be like 1:start, 5:lower or 8:forward=0.6.")
    if name not in (*BUTTONS, *STICKS, *GANTRY):
        raise unknown("script: button, stick or action", name, (*BUTTONS, *STICKS, *GANTRY))
    return at, name, number
