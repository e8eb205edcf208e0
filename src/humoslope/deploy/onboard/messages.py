"""What a robot says, what it is told, and the link between the two."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from humoslope.deploy.quantities import Array


@dataclass(frozen=True)
class Remote:
    """State of the remote control.

    Attributes:
        buttons: Names of the buttons that are pressed, of `unitree_g1.BUTTONS`.
        forward: Left stick forward, in [-1, 1].
        left: Left stick to the left, in [-1, 1].
        turn: Right stick to the left, in [-1, 1].
    """

    buttons: frozenset[str] = frozenset()
    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0


@dataclass(frozen=True)
class Reading:
    """One message of the robot. Joints are in the order of the contract.

    Attributes:
        count: Number of different messages so far; one that does not grow is an old message.
        quat_w: [4] orientation of the IMU, w first.
        ang_vel_b: [3] angular velocity in the axes of the IMU, rad/s.
        joint_pos: [J] joint positions, rad.
        joint_vel: [J] joint velocities, rad/s.
        torque: [J] estimated torques, Nm.
        temperature: [J] temperatures of the motors, degrees Celsius.
        errors: [J] error codes of the motors, 0 for none; all 0 where a link cannot tell.
        mode_machine: Code of the robot's build.
        remote: The remote control.
    """

    count: int
    quat_w: Array
    ang_vel_b: Array
    joint_pos: Array
    joint_vel: Array
    torque: Array
    temperature: Array
    errors: Array
    mode_machine: int
    remote: Remote

    @property
    def usable(self) -> bool:
        """False if a number is not finite, or the orientation is none."""
        numbers = (self.quat_w, self.ang_vel_b, self.joint_pos, self.joint_vel, self.torque, self.temperature)
        finite = all(bool(np.isfinite(values).all()) for values in numbers)
        return finite and abs(float(np.linalg.norm(self.quat_w)) - 1.0) <= 0.01


@dataclass(frozen=True)
class Command:
    """Command to the motors: `torque = stiffness (target - position) - damping velocity`, computed in each motor.

    Attributes:
        target: [J] target positions, rad.
        stiffness: [J] proportional gains, Nm/rad.
        damping: [J] derivative gains, Nm s/rad.
    """

    target: Array
    stiffness: Array
    damping: Array


class Inbox:
    """The usable messages of the last moments.

    Attributes:
        refused: Number of messages that were not usable.

    Args:
        span_s: Time for which messages are kept, s.
    """

    def __init__(self, span_s: float = 0.5) -> None:
        self._span_s = span_s
        self._messages: deque[tuple[float, Reading]] = deque()
        self.refused = 0

    def add(self, now: float, reading: Reading) -> None:
        """Takes a message that came at time `now`, s."""
        if not reading.usable:
            self.refused += 1
            return
        self._messages.append((now, reading))
        while self._messages[0][0] < now - self._span_s:
            self._messages.popleft()

    def read(self, now: float, age_s: float) -> Reading | None:
        """See `Link.read`."""
        messages = list(self._messages)  # another thread may add to them
        for came, reading in reversed(messages):
            if came <= now - age_s + 1e-6:
                return reading
        return messages[0][1] if messages else None


class Link(Protocol):
    """A connection to one robot. What was written last is repeated to the robot until something else is written."""

    def read(self, age_s: float = 0.0) -> Reading | None:
        """Returns the newest message that came at least `age_s` ago, else the oldest that is kept; None before the
        first one."""

    def write(self, command: Command) -> None:
        """Sends a command from now on."""

    def foreign(self) -> bool:
        """Returns whether somebody else commands the motors, as far as this link can see."""

    def close(self) -> None:
        """Ends the connection."""
