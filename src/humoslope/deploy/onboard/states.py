"""The states of a robot on its way from hanging limp to walking, and back to damped: a pure state machine.

    wait -> zero torque -> move -> hold -> walk      (start, start, time, walk)
              (from each of them, on a request to stop or on a fault) -> damping

Nothing leads out of damping: whoever wants to walk again starts the program again, beside the robot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum, auto

import numpy as np

from humoslope.deploy.contract import Contract
from humoslope.deploy.onboard.messages import Command
from humoslope.deploy.quantities import Array

MOVE_S = 3.0
"""Time for the way from the measured pose to the default one, s. Unitree's own deployments take 2 to 3."""
DAMPING_NMS_RAD = 5.0
"""Derivative gain of a damped joint, Nm s/rad. Unitree's own deployments have 3 to 8."""


class Mode(Enum):
    """State of the robot."""

    WAIT = auto()
    ZERO_TORQUE = auto()
    MOVE = auto()
    HOLD = auto()
    WALK = auto()
    DAMPING = auto()

    @property
    def words(self) -> str:
        """Name for people."""
        return self.name.lower().replace("_", " ")

    @property
    def upright(self) -> bool:
        """True in states in which the robot is to be upright."""
        return self in (Mode.MOVE, Mode.HOLD, Mode.WALK)


class Request(Enum):
    """What a person asks for."""

    START = auto()
    WALK = auto()
    STOP = auto()


@dataclass(frozen=True)
class State:
    """State of the machine.

    Attributes:
        mode: The mode.
        since: Time at which it began, s.
        pose: Joint positions from which the move began, rad; empty before.
        reason: Why the motors are damped; empty before.
    """

    mode: Mode = Mode.WAIT
    since: float = 0.0
    pose: tuple[float, ...] = ()
    reason: str = ""


@dataclass(frozen=True)
class Seen:
    """What the machine decides by, at one instant.

    Attributes:
        now: Time, s.
        pose: Measured joint positions, rad; None before the robot's first message.
        requests: Requests since the last instant.
        hindrance: Why the robot must not be moved from where it is; None if nothing speaks against it.
        fault: Why it must not go on; None if nothing speaks against it.
    """

    now: float
    pose: tuple[float, ...] | None = None
    requests: frozenset[Request] = frozenset()
    hindrance: str | None = None
    fault: str | None = None


def advance(state: State, seen: Seen) -> State:
    """Returns the state that follows.

    A hindrance keeps the robot waiting in the first two states, in which it is limp anyway; a fault or a request to
    stop damps it from every state but the first, in which nothing has been sent yet.
    """
    if state.mode is Mode.DAMPING:
        return state
    reason = seen.fault if state.mode is not Mode.WAIT else None
    if Request.STOP in seen.requests:
        reason = "stop was asked for"
    if reason is not None:
        return replace(state, mode=Mode.DAMPING, since=seen.now, reason=reason)
    following = _following(state, seen)
    if following is None:
        return state
    pose = seen.pose or () if following is Mode.MOVE else state.pose
    return replace(state, mode=following, since=seen.now, pose=pose)


def _following(state: State, seen: Seen) -> Mode | None:
    """The next mode on the way to walking, if it is time for it."""
    ready = seen.pose is not None and seen.hindrance is None and seen.fault is None
    steps = {
        Mode.WAIT: (Mode.ZERO_TORQUE, ready and Request.START in seen.requests),
        Mode.ZERO_TORQUE: (Mode.MOVE, ready and Request.START in seen.requests),
        Mode.MOVE: (Mode.HOLD, seen.now - state.since >= MOVE_S),
        Mode.HOLD: (Mode.WALK, Request.WALK in seen.requests),
    }
    following, due = steps.get(state.mode, (None, False))
    return following if due else None


def command(state: State, now: float, contract: Contract, walking: Array | None = None) -> Command | None:
    """Returns what is sent to the motors in a state; None for nothing.

    Args:
        state: The state.
        now: Time, s.
        contract: The contract.
        walking: [J] targets of the policy, rad; used in the state that walks, where they are needed.
    """
    joints, zeros = contract.joints, np.zeros(len(contract.joints))
    default = np.array([joint.default_rad for joint in joints])
    if state.mode is Mode.WAIT:
        return None
    if state.mode is Mode.ZERO_TORQUE:
        # Without gains targets mean nothing; but a command of zeros alone could not be told from none.
        return Command(default, zeros, zeros)
    if state.mode is Mode.DAMPING:
        return damping(contract)
    target = default
    if state.mode is Mode.MOVE:
        part = min(1.0, max(0.0, (now - state.since) / MOVE_S))
        start = np.array(state.pose)
        target = start + (default - start) * 0.5 * (1.0 - math.cos(math.pi * part))
    elif state.mode is Mode.WALK:
        assert walking is not None
        target = walking
    gains = ([getattr(joint, name) for joint in joints] for name in ("stiffness_nm_rad", "damping_nms_rad"))
    return Command(target, *map(np.array, gains))


def damping(contract: Contract) -> Command:
    """Returns the command that damps every joint."""
    zeros = np.zeros(len(contract.joints))
    return Command(zeros, zeros, np.full(len(contract.joints), DAMPING_NMS_RAD))
