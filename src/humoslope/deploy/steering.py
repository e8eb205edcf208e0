"""What a person asks of a walking robot, by keys, sliders or a stick, within what its policy was trained for."""

from __future__ import annotations

import numpy as np

from humoslope.deploy.contract import Commands, Range
from humoslope.deploy.quantities import Array

STEP = 0.1
"""Change of the command by one key press, m/s or rad/s."""


class Steering:
    """The command that the last hand on the controls has asked for.

    Args:
        commands: Ranges that the policy was trained with.
        speed: Forward speed to begin with, m/s; it may lie outside of them.

    Attributes:
        restart: True once a restart has been asked for; to be cleared by the caller.
    """

    def __init__(self, commands: Commands, speed: float) -> None:
        self._forward, self._yaw_rate = commands.forward_m_s, commands.yaw_rate_rad_s
        low, high = self._forward
        self._stands = commands.trained_to_stand or low <= 0.0 <= high
        self._speeds, self._turns = _levels(self._forward, self._stands), _levels(self._yaw_rate, True)
        self._speed, self._turn = speed, 0.0
        self.restart = False

    @property
    def command(self) -> Array:
        """Forward speed, lateral speed and yaw rate, [3]."""
        return np.array([self._speed, 0.0, self._turn])

    @property
    def stands(self) -> bool:
        """Whether the policy can be asked to stand still."""
        return self._stands

    @property
    def speeds(self) -> Range:
        """Slowest and fastest speed that can be asked for, m/s."""
        return float(self._speeds[0]), float(self._speeds[-1])

    @property
    def turns(self) -> Range:
        """Yaw rates to the right and to the left that can be asked for, rad/s."""
        return float(self._turns[0]), float(self._turns[-1])

    def step_speed(self, up: bool) -> None:
        """Goes to the next higher or lower speed."""
        self._speed = _next(self._speeds, self._speed, up)

    def step_turn(self, left: bool) -> None:
        """Goes to the next yaw rate further to the left or to the right."""
        self._turn = _next(self._turns, self._turn, left)

    def stand(self) -> None:
        """Asks to stand still; without effect on a policy that was not trained to."""
        if self._stands:
            self._speed = self._turn = 0.0

    def start_over(self) -> None:
        """Asks for the start of the course."""
        self.restart = True

    def ask_speed(self, speed: float) -> None:
        """Asks for a speed, m/s; one that was not trained becomes the nearest that was."""
        low, high = self._forward
        nearest = min(max(speed, low), high)
        self._speed = 0.0 if self._stands and abs(speed) < abs(nearest - speed) else nearest

    def ask_turn(self, yaw_rate: float) -> None:
        """Asks for a yaw rate, rad/s, positive to the left; one that was not trained becomes the nearest that was."""
        low, high = self.turns
        self._turn = min(max(yaw_rate, low), high)

    def push(self, forward: float, left: float) -> None:
        """Asks for what a stick means: its whole way stands for the trained range, its middle for standing still.

        A policy that cannot stand walks as slowly as it can, and one that cannot walk backward (or forward) takes that
        for the middle.

        Args:
            forward: Place of the stick from -1, backward, to 1, forward.
            left: Place of the stick from -1, right, to 1, left.
        """
        low, high = self._forward
        slowest_ahead, slowest_back = max(low, 0.0), min(high, 0.0)
        if forward > 0.0 and high > 0.0:
            self._speed = slowest_ahead + forward * (high - slowest_ahead)
        elif forward < 0.0 and low < 0.0:
            self._speed = slowest_back - forward * (low - slowest_back)
        else:
            self._speed = 0.0 if self._stands else slowest_ahead + slowest_back
        right, to_left = self.turns
        self._turn = left * to_left if left >= 0.0 else -left * right


def _levels(limits: Range, zero: bool) -> Array:
    """Returns the values that a key steps through."""
    low, high = limits
    levels = np.append(np.arange(low, high - 1e-9, STEP), high)
    return np.unique(np.round(np.append(levels, 0.0) if zero else levels, 6))


def _next(levels: Array, value: float, up: bool) -> float:
    further = levels[levels > value + 1e-9] if up else levels[levels < value - 1e-9][::-1]
    return float(further[0]) if len(further) else value
