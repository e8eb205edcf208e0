"""How a robot walks: figures of its gait over a trial, beyond where it goes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from humoslope.deploy.quantities import Array
from humoslope.statistics import mean

FOOT_DOWN_N = 5.0
"""A foot is down while the ground carries it with at least this force, N."""
SWING_S = 0.06
"""A foot that was not down for a shorter time, s, has not stepped: contacts of a standing foot flicker."""
STEP = f"step: a foot comes down after {SWING_S:g} s and more with less than {FOOT_DOWN_N:g} N"
"""What counts as a step, wherever steps are counted."""
FAST_HZ = 10.0
"""Frequency above which joint targets count as fast: several times that of any step."""
MOVES_RAD = 0.01
"""Standard deviation of a joint's target below which the joint counts as still, so that noise has no share of it."""


@dataclass(frozen=True)
class Gait:
    """Figures of a trial from when the robot has settled; NaN if it did not last that long.

    Attributes:
        self_contact: Share of the time in which two parts of the robot press on each other.
        double_support: Share of the time in which all feet are down.
        knee_flexion: Mean angle of the knees, rad; NaN if no joint is called a knee.
        fast_share: Share of the variance of a joint's target above `FAST_HZ`, of the joint with the largest share.
    """

    self_contact: float
    double_support: float
    knee_flexion: float
    fast_share: float


class GaitRecorder:
    """Collects what `Gait` consists of, step by step.

    Args:
        joints: Names of the joints, in the order of targets and positions.
        dt: Control step, s.
    """

    def __init__(self, joints: Sequence[str], dt: float) -> None:
        self._knees, self._dt = [i for i, name in enumerate(joints) if "knee" in name], dt
        self._targets: list[Array] = []
        self._steps = self._touching = self._all_down = 0
        self._flexion = 0.0

    def add(self, target: Array, joint_pos: Array, down: NDArray[np.bool_], touches_itself: bool) -> None:
        """Adds a control step: targets and positions [J], rad; which feet are down [F]; whether parts touch."""
        self._steps += 1
        self._targets.append(target)
        self._touching += touches_itself
        self._all_down += bool(down.all())
        self._flexion += float(joint_pos[self._knees].mean()) if self._knees else math.nan

    def gait(self) -> Gait:
        """Returns the figures of the steps so far."""
        n = self._steps or math.nan
        return Gait(
            self._touching / n,
            self._all_down / n,
            self._flexion / n,
            fast_share(np.array(self._targets), self._dt) if self._targets else math.nan,
        )


def mean_gait(gaits: Sequence[Gait]) -> Gait:
    """Means over the gaits that are not NaN."""
    means = (mean(np.array([getattr(gait, field.name) for gait in gaits])) for field in fields(Gait))
    return Gait(*(math.nan if value is None else value for value in means))


def fast_share(targets: Array, dt: float) -> float:
    """Share of the variance of a joint's targets that lies above `FAST_HZ`, of the joint with the largest share.

    Args:
        targets: [T, J] rad, one every `dt` seconds.
        dt: Time between targets, s.

    Returns:
        The share, in [0, 1]; 0 if no joint moves by `MOVES_RAD`.
    """
    power = np.abs(np.fft.rfft(targets - targets.mean(axis=0), axis=0)) ** 2  # [T // 2 + 1, J]
    # Frequencies between 0 and the highest one stand for their negative as well (Parseval).
    power[1 : (len(targets) + 1) // 2] *= 2.0
    fast = np.fft.rfftfreq(len(targets), dt) > FAST_HZ
    moving = targets.std(axis=0) >= MOVES_RAD
    return float((power[fast].sum(axis=0) / power.sum(axis=0))[moving].max()) if moving.any() else 0.0
