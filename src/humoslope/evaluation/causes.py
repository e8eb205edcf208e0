"""Why a robot failed: the first thing that went wrong, from what was recorded shortly before the end.

Everything follows a fall at once: feet slide, motors saturate, joints run into their limits. So what the ground does
(slip, stumble) must have begun before the robot leaned further or faster than it ever does in a walk, and what it
itself does (torque limit, joint limit), as it also does to catch itself, before it began to lean, and lasted until
then. Of the causes that did, the first one counts; if there is none, the robot tipped: it lost its balance while ground
and motors could still have held it, as after a push.

Signals are instants at the control rate. What lasts less than a control step, such as the hardest part of an impact,
may fall between two of them. The thresholds are ours, with their reasons beside them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from humoslope.statistics import Array, Bools

SLIP, STUMBLE, TORQUE, JOINT, TIP = "slip", "stumble", "torque limit", "joint limit", "tip"
OFF_TRACK, OUT_OF_TIME, UNCLEAR, UNRECORDED = "off the track", "out of time", "unclear", "not recorded"
CAUSES = (SLIP, STUMBLE, TORQUE, JOINT, TIP, OFF_TRACK, OUT_OF_TIME, UNCLEAR, UNRECORDED)
"""All that a failure can be put down to. "Unclear" is a fall in which no threshold was reached, "not recorded" one from
before the signals were kept."""

MEANING = {
    SLIP: "a loaded foot slid on the ground, at the limit of friction",
    STUMBLE: "a shin touched the ground, or a foot ran against something steeper than friction explains",
    TORQUE: "a motor of legs or waist was at its limit",
    JOINT: "a joint of legs or waist was at the end of its range",
    TIP: "the robot lost its balance, with feet, motors and joints within their limits",
    OFF_TRACK: "it walked off the side of the track",
    OUT_OF_TIME: "it did not arrive in time",
    UNCLEAR: "no threshold was reached",
    UNRECORDED: "trials from before these signals were kept",
}

WINDOW_S = 1.5
"""Time before the end that is looked at, s. A pendulum of a G1's height needs some 0.9 s from a lean of 5 degrees to
one of 70, the end of a trial; what threw it off came before that."""
SIDES = ("left", "right")
SIGNALS = (
    "tilt",
    "torque_use",
    "joint_margin",
    "shin_load",
    "friction",
    *(f"foot_{kind}_{side}" for kind in ("load", "drag", "speed") for side in SIDES),
)
"""What is recorded at each control step. Forces are shares of the robot's weight.

    tilt            angle of the root's up axis from the vertical, rad
    torque_use      largest |torque| of a joint of legs or waist, as a share of what its motor can do
    joint_margin    least distance of such a joint from an end of its range, rad; negative beyond it
    shin_load       largest ground force on a shin
    friction        coefficient of friction between feet and ground
    foot_load_      ground force on a foot along the ground's normal
    foot_drag_      ground force on a foot across it
    foot_speed_     speed of the centre of the sole along the ground, m/s
"""

LOADED = 0.2
"""Share of the weight from which a foot bears the robot. A foot that touches down or takes off bears less, and slides
in every walk."""
SLIDING = 0.2
"""Speed of a sole that slides, m/s; rolling from heel to toe moves its centre by less."""
AT_CONE = 0.8
"""Share of the friction cone from which a foot may slide. Less than 1, as the contacts of a sole on rough ground have
normals of their own, so that the sum of their forces lies within the cone when each of them is on it."""
SLIP_LENGTH = 0.04
"""Way of a loaded sole that makes a slip, m: a fifth of its length. Landing feet of the shipped Stage II slide by up to
2 cm on the held-out track; slips that it survived on rough ground of 30 degrees went up to 9 cm."""
SHIN_LOAD = 0.05
"""Ground force on a shin, share of the weight: a knee on the ground. Nothing but feet touches it in a walk."""
SWINGING = 0.5
"""Speed of a foot that is being brought forward, m/s."""
STRIKE_LOAD, STRIKE_CONE = 0.1, 3.0
"""Force across the ground on a swinging foot, share of the weight, and how many times what friction allows: more than
this is no friction but something that stands in its way. On the edges of rough ground the shipped Stage II reaches
twice of what friction allows up to three times in half a minute, and not three times as much."""
FULL_TORQUE = 0.98
"""Share of its largest torque from which a motor is at its limit."""
AT_LIMIT = 0.01
"""Distance of a joint from the end of its range at which it is there, rad; a stop of MuJoCo is a little soft."""
TORQUE_S = 0.1
"""Time at full torque that is no peak of a step any more, s; the shipped Stage II needs it for at most 0.06 s."""
JOINT_S = 0.2
"""Time at the end of a joint's range that is no part of a step any more, s: on 30 degrees the shipped Stage II
stretches a leg to its end for up to 0.16 s in a step."""
LEANING = math.radians(15.0)
"""Lean of the root from the vertical beyond which a robot is not in balance any more, rad; the shipped Stage II reaches
14 degrees on slopes of 30."""
TOPPLING = 1.3
"""Rate of the lean that is a fall already, rad/s; in walks of the shipped policies on slopes of 30 degrees it is below
1.24 for 99.9 % of the time."""
EFFECT_S = 0.3
"""Time until what the ground does shows in the lean, s: what ended earlier before the robot began to lean was survived.
A pendulum of a G1's height takes 0.28 s to lean e times as far."""


@dataclass(frozen=True)
class Finding:
    """The first cause of a failure.

    Attributes:
        cause: One of `CAUSES`.
        before_s: When it began, s before the end; 0 where that has no meaning.
        text: What happened, for a human; "" if there is no more to say.
    """

    cause: str
    before_s: float = 0.0
    text: str = ""


@dataclass(frozen=True)
class _Stretch:
    """Rows from `first` to `last` in which something held."""

    first: int
    last: int
    text: str = ""


def first_cause(moments: Mapping[str, NDArray[Any]], dt: float) -> Finding:
    """The first cause of a fall.

    Args:
        moments: `SIGNALS` [K] in the order of time, the last one of the moment of the fall; NaN in all of them where
            nothing was recorded yet.
        dt: Time between two rows, s.
    """
    there = np.isfinite(moments["tilt"].astype(np.float64))
    if not there.any():
        return Finding(UNRECORDED)
    known = {name: moments[name][there].astype(np.float64) for name in SIGNALS}
    rows = int(there.sum())
    lean = _lean(known["tilt"], dt)
    found: list[tuple[int, int, str, str]] = []
    ground = (SLIP, _slips(known, dt)), (STUMBLE, _stumbles(known))
    own = (
        (TORQUE, _held(known["torque_use"] >= FULL_TORQUE, TORQUE_S, dt, "a motor is at its limit")),
        (JOINT, _held(known["joint_margin"] <= AT_LIMIT, JOINT_S, dt, "a joint is at its end")),
    )
    for rank, (cause, stretches) in enumerate((*ground, *own)):
        for stretch in stretches:
            if cause in (SLIP, STUMBLE):
                counts = stretch.first <= lean.last and (lean.first - stretch.last) * dt <= EFFECT_S
            else:  # a limit that the robot has left again holds nothing back
                counts = stretch.first <= lean.first <= stretch.last
            if counts:
                found.append((stretch.first, rank, cause, stretch.text))
    if found:
        row, _, cause, text = min(found)
        return Finding(cause, (rows - 1 - row) * dt, text)
    if known["tilt"][-1] < LEANING:
        return Finding(UNCLEAR)
    angle = math.degrees(known["tilt"][lean.first])
    return Finding(TIP, (rows - 1 - lean.first) * dt, f"the robot tips over from a lean of {angle:.0f}°")


def first_causes(
    moments: Mapping[str, NDArray[Any]], dt: float, *, fell: Bools, left: Bools, timed_out: Bools
) -> list[str]:
    """The first cause of every failed trial, of `CAUSES`; "" for all others.

    Args:
        moments: `SIGNALS` [T, K] as in `first_cause`; empty if nothing was recorded.
        dt: Control step, s.
        fell, left, timed_out: [T] how they ended.
    """

    def cause(trial: int) -> str:
        if not fell[trial]:
            return OFF_TRACK if left[trial] else OUT_OF_TIME if timed_out[trial] else ""
        return first_cause({name: moments[name][trial] for name in SIGNALS}, dt).cause if moments else UNRECORDED

    return [cause(trial) for trial in range(len(fell))]


def count(causes: Sequence[str]) -> dict[str, int]:
    """How often each of `CAUSES` occurs; zeros are left out."""
    return {name: causes.count(name) for name in CAUSES if name in causes}


def _lean(tilt: Array, dt: float) -> _Stretch:
    """The rows in which the robot began to lean for good, until it leaned by `LEANING` or at `TOPPLING`; the last row
    twice if it never leans that far, as one that sinks."""
    end = len(tilt) - 1
    if tilt[end] < LEANING:
        return _Stretch(end, end)
    upright = np.flatnonzero(tilt < LEANING)
    last = int(upright[-1]) if len(upright) else 0
    still = np.flatnonzero(np.diff(tilt[: last + 1]) <= 0.0)
    first = int(still[-1]) + 1 if len(still) else 0
    # Over two steps: a single one is as coarse as the signal.
    rate = (tilt[first + 2 : last + 1] - tilt[first : max(first, last - 1)]) / (2.0 * dt)
    fast = np.flatnonzero(rate > TOPPLING)
    return _Stretch(first, first + int(fast[0]) if len(fast) else last)


def _slips(known: Mapping[str, Array], dt: float) -> list[_Stretch]:
    slips = []
    for side in SIDES:
        load, drag, speed = (known[f"foot_{kind}_{side}"] for kind in ("load", "drag", "speed"))
        sliding = (load >= LOADED) & (speed >= SLIDING) & (drag >= AT_CONE * known["friction"] * load)
        for first, last in _runs(sliding):
            way = float(speed[first : last + 1].sum() * dt)
            if way >= SLIP_LENGTH:
                slips.append(_Stretch(first, last, f"the {side} foot slides by {100.0 * way:.0f} cm"))
    return slips


def _stumbles(known: Mapping[str, Array]) -> list[_Stretch]:
    struck = [_Stretch(*run, "a shin is on the ground") for run in _runs(known["shin_load"] >= SHIN_LOAD)]
    for side in SIDES:
        load, drag, speed = (known[f"foot_{kind}_{side}"] for kind in ("load", "drag", "speed"))
        # A foot that is stopped is slow already at the instant after.
        swinging = np.maximum(speed, np.concatenate([speed[:1], speed[:-1]])) >= SWINGING
        against = swinging & (drag >= STRIKE_LOAD) & (drag > STRIKE_CONE * known["friction"] * np.maximum(load, 0.0))
        struck += [_Stretch(*run, f"the {side} foot runs against the ground") for run in _runs(against)]
    return struck


def _held(at_limit: Bools, seconds: float, dt: float, text: str) -> list[_Stretch]:
    """Stretches of at least `seconds` in which a limit is reached."""
    least = seconds / dt - 1e-6
    return [_Stretch(first, last, text) for first, last in _runs(at_limit) if last - first + 1 >= least]


def _runs(mask: Bools) -> list[tuple[int, int]]:
    """The first and the last row of each stretch of true rows."""
    steps = np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))
    starts, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1) - 1
    return [(int(first), int(last)) for first, last in zip(starts, ends, strict=True)]
