"""Whether the IMU turns as the leg says that carries the robot."""

from __future__ import annotations

import math

import numpy as np

from humoslope.deploy.contract import Contract
from humoslope.deploy.doctor.walk import Finding, Walk
from humoslope.deploy.onboard.kinematics import Kinematics
from humoslope.deploy.quantities import Array

LOADED_N = 150.0
"""A foot that carries more, N, stands; one that carries less may roll."""
LAGS_MS = np.arange(-20.0, 80.1, 1.0)
"""Ages of the IMU against the encoders that are tried, ms."""
LATE_MS = 4.0
TILTED_DEG = 4.0
"""Deviations from which on the IMU counts as late or tilted."""
FEWEST = 40
"""Smallest number of instants for a statement."""


def check(walk: Walk, contract: Contract, kinematics: Kinematics) -> list[Finding]:
    """Checks the gyroscope against the orientation, then the IMU's time and mounting against the standing leg."""
    findings = [_gyro(walk, contract)]
    leg, weight = _from_leg(walk, kinematics)
    if (weight > 0.0).sum() < FEWEST:
        return [*findings, Finding("IMU", False, "no foot stood still for long enough; nothing more can be said")]
    gyro = walk.ang_vel_b * (-1.0 if findings[0].wrong and "opposite" in findings[0].words else 1.0)
    lag = _lag_ms(gyro, leg, weight, contract.timing.control_step_s)
    late = abs(lag) > LATE_MS
    findings.append(Finding("age of the IMU", late, f"it is {lag:.0f} ms older than the encoders"))
    shifted = _shifted(leg, lag, contract.timing.control_step_s)
    tilt = _rotation(gyro, shifted, weight)
    angle = math.degrees(float(np.linalg.norm(tilt[:2])))
    axes = ", ".join(f"{math.degrees(a):+.1f} about {name}" for a, name in zip(tilt, "xyz", strict=True))
    findings.append(Finding("mounting of the IMU", angle > TILTED_DEG, f"turned by {angle:.1f} degrees ({axes})"))
    return findings


def _gyro(walk: Walk, contract: Contract) -> Finding:
    """The gyroscope against the rate of the orientation, over a control step."""
    dt = contract.timing.control_step_s
    rate = np.array([_rate(a, b) / dt for a, b in zip(walk.quat_w[:-1], walk.quat_w[1:], strict=True)])
    mean = 0.5 * (walk.ang_vel_b[1:] + walk.ang_vel_b[:-1])
    slopes = (rate * mean).sum(axis=0) / np.maximum((rate * rate).sum(axis=0), 1e-12)
    shown = ", ".join(f"{value:+.2f}" for value in slopes)
    words = f"is {shown} (x, y, z) times the rate of the orientation"
    if (slopes < 0.0).all():
        return Finding("gyroscope", True, f"has the opposite sign: {words}")
    return Finding("gyroscope", bool((np.abs(slopes - 1.0) > 0.4).any()), words)


def _rate(a: Array, b: Array) -> Array:
    """Rotation vector, in the axes of the body, from one orientation to the next, [3] rad."""
    aw, av, bw, bv = a[0], a[1:], b[0], b[1:]
    w = aw * bw + av @ bv
    v = aw * bv - bw * av - np.cross(av, bv)
    return np.asarray(2.0 * v * np.sign(w)) if w else 2.0 * v


def _from_leg(walk: Walk, kinematics: Kinematics) -> tuple[Array, Array]:
    """Angular velocity of the root by the leg that stands, [T, 3] rad/s, and its weight, [T]; 0 where none stands."""
    rate, weight = np.zeros((len(walk), 3)), np.zeros(len(walk))
    for k in range(len(walk)):
        kinematics.pose(walk.quat_w[k], walk.joint_pos[k])
        load = kinematics.wrenches(walk.torque[k])[:, 2]
        foot = int(np.argmax(load))
        rate[k] = kinematics.turning(walk.joint_vel[k])[foot]
        # Only one foot, and in the middle of its stance: at its ends it rolls over heel and toes.
        weight[k] = float(load[foot] > LOADED_N and load[1 - foot] < 0.3 * load[foot])
    inner = np.zeros_like(weight)
    inner[2:-2] = weight[2:-2] * weight[1:-3] * weight[3:-1]
    return rate, inner


def _shifted(values: Array, lag_ms: float, dt: float) -> Array:
    """Values [T, 3] as they were `lag_ms` ago, between two control steps interpolated."""
    time = np.arange(len(values)) * dt
    return np.stack([np.interp(time - 1e-3 * lag_ms, time, values[:, axis]) for axis in range(3)], axis=1)


def _lag_ms(gyro: Array, leg: Array, weight: Array, dt: float) -> float:
    """Age of the gyroscope against the leg, ms: the one with the best fit up to a rotation and a factor."""
    use = weight > 0.0
    rest = []
    for lag in LAGS_MS:
        shifted = _shifted(leg, lag, dt)[use]
        fitted, _, _, _ = np.linalg.lstsq(shifted, gyro[use], rcond=None)
        rest.append(float(np.square(gyro[use] - shifted @ fitted).sum()))
    return float(LAGS_MS[int(np.argmin(rest))])


def _rotation(gyro: Array, leg: Array, weight: Array) -> Array:
    """Rotation vector [3], rad, that turns the root's axes into the IMU's (Kabsch)."""
    covariance = (gyro * weight[:, None]).T @ leg  # gyro = R^T leg
    u, _, vt = np.linalg.svd(covariance)
    flip = np.diag([1.0, 1.0, np.linalg.det(u @ vt)])
    r = (u @ flip @ vt).T
    angle = math.acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(r)) - 1.0))))
    axis = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    size = float(np.linalg.norm(axis))
    return axis * (angle / size if size > 1e-9 else 0.0)
