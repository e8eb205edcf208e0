"""Whether the IMU agrees with itself, in time with the encoders, and in its mounting with what the feet carry."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path

import numpy as np

from humoslope.deploy import rotation
from humoslope.deploy.contract import Contract
from humoslope.deploy.doctor.walk import Finding, Walk
from humoslope.deploy.onboard.kinematics import Kinematics
from humoslope.deploy.player import Player, TrialCfg
from humoslope.deploy.quantities import Array

REFERENCE_GRADES, REFERENCE_S = (0.0, 15.0, -15.0), 7.0
"""Simulated walks of the same export that say how the gyroscope follows from the encoders: grades, degrees, and s."""
BEGINNING, END = 50, 50
"""Control steps at both ends that are left out: a walk that begins, and one that may end in a fall, is not steady."""
LAGS_MS = np.arange(-40.0, 80.1, 1.0)
"""Ages of the IMU against the encoders that are tried, ms."""
LATE_MS = 9.0
"""Age from which on the IMU counts as late, ms. Simulated, 15 and 30 ms were found as 16 to 18 and 32 to 33; soft
motors looked like -9."""
ALIKE = 0.6
"""Share of the gyroscope's variance that must follow from the encoders for a statement."""
TILTED_DEG = 2.0
"""Tilt from which on the IMU counts as tilted, degrees. Simulated sound walks gave up to 1.0, also on slopes."""


def check(walk: Walk, contract: Contract, folder: Path, kinematics: Kinematics) -> list[Finding]:
    """Checks the gyroscope against the orientation, then the IMU's age and its mounting."""
    findings = [_gyro(walk, contract)]
    steady = slice(BEGINNING, max(len(walk) - END, BEGINNING))
    if len(walk.action[steady]) < BEGINNING:
        return [*findings, Finding("IMU", False, "the walk is too short to say more")]
    opposite = findings[0].wrong and "opposite" in findings[0].words
    return [*findings, _age(walk, contract, folder, -1.0 if opposite else 1.0), _mounting(walk, kinematics, steady)]


def _gyro(walk: Walk, contract: Contract) -> Finding:
    """The gyroscope against the rate of the orientation, over a control step."""
    dt = contract.timing.control_step_s
    rate = np.array([_turn(a, b) / dt for a, b in zip(walk.quat_w[:-1], walk.quat_w[1:], strict=True)])
    mean = 0.5 * (walk.ang_vel_b[1:] + walk.ang_vel_b[:-1])
    slope = float((rate * mean).sum() / max(float((rate * rate).sum()), 1e-12))
    words = f"is {slope:+.2f} times the rate of the orientation"
    if slope < 0.0:
        return Finding("gyroscope", True, f"has the opposite sign: {words}")
    return Finding("gyroscope", abs(slope - 1.0) > 0.4, words)


def _turn(a: Array, b: Array) -> Array:
    """Rotation vector, in the axes of the body, from one orientation to the next, [3] rad."""
    aw, av, bw, bv = a[0], a[1:], b[0], b[1:]
    w = aw * bw + av @ bv
    v = aw * bv - bw * av - np.cross(av, bv)
    return np.asarray(2.0 * v * (1.0 if w >= 0.0 else -1.0))


def _age(walk: Walk, contract: Contract, folder: Path, sign: float) -> Finding:
    """How much older the gyroscope is than the encoders, from which it follows in a walk: as in simulated ones."""
    gyro, features = _reference(contract, folder)
    # A little of a ridge: joints that hardly move say nothing.
    fit = np.linalg.solve(features.T @ features + 0.1 * np.eye(features.shape[1]), features.T @ gyro)
    default = np.array([joint.default_rad for joint in contract.joints])
    expected = _features(walk.joint_pos - default, walk.joint_vel) @ fit
    time = np.arange(len(walk)) * contract.timing.control_step_s
    inner = slice(BEGINNING, len(walk) - 8)
    alike = []
    for lag in LAGS_MS:
        shown = sign * np.stack([np.interp(time + 1e-3 * lag, time, axis) for axis in walk.ang_vel_b.T], axis=1)[inner]
        variance = float(np.square(shown - shown.mean(axis=0)).sum())
        alike.append(1.0 - float(np.square(shown - expected[inner]).sum()) / max(variance, 1e-12))
    best = int(np.argmax(alike))
    if alike[best] < ALIKE:
        return Finding("age of the IMU", False, "cannot be told: the walk is not like a simulated one")
    lag = float(LAGS_MS[best])
    return Finding("age of the IMU", abs(lag) > LATE_MS, f"it is {lag:.0f} ms older than the encoders")


@lru_cache(maxsize=1)
def _reference(contract: Contract, folder: Path) -> tuple[Array, Array]:
    """Gyroscope [K, 3] and features [K, F] of simulated walks."""
    gyro, features = [], []
    for grade in REFERENCE_GRADES:
        player = Player(folder, contract, TrialCfg(grade=grade, seconds=REFERENCE_S))
        player.start(np.random.default_rng(0))
        for step in range(round(REFERENCE_S / contract.timing.control_step_s)):
            measured = player.world.measured(np.zeros(3), player.controller.last_action)
            if player.world.fallen():
                break
            if step >= BEGINNING:
                gyro.append(measured.root_ang_vel_b.copy())
                features.append(_features(measured.joint_pos_rel, measured.joint_vel))
            player.step(player.course_command())
    return np.array(gyro), np.array(features)


def _features(joint_pos_rel: Array, joint_vel: Array) -> Array:
    return np.concatenate([joint_pos_rel, 0.1 * joint_vel, np.ones((*joint_pos_rel.shape[:-1], 1))], axis=-1)


def _mounting(walk: Walk, kinematics: Kinematics, steady: slice) -> Finding:
    """The IMU's up against the direction from the centre of pressure to the centre of mass, both in the root's axes.

    While a robot walks steadily the two are the same on average, on any slope: else it would fall over.
    """
    upright, mean_up, mean_leg = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3)
    for quat, joints, torque in zip(walk.quat_w[steady], walk.joint_pos[steady], walk.torque[steady], strict=True):
        kinematics.pose(upright, joints)  # the root's axes are the world's
        wrenches = kinematics.wrenches(torque)
        load = np.maximum(wrenches[:, 2], 0.0)
        if not load.any():
            continue
        pos, turned = kinematics.feet_poses()
        pressed = [pos[i] + turned[i] @ kinematics.pressed(wrenches[i], turned[i], i) for i in range(2)]
        mean_leg += load.sum() * kinematics.com() - load @ np.array(pressed)
        mean_up += rotation.up_b(quat / np.linalg.norm(quat))
    if not mean_leg.any():
        return Finding("mounting of the IMU", False, "cannot be told: no torques of a leg that carries were recorded")
    tilt = np.degrees(np.cross(mean_up / np.linalg.norm(mean_up), mean_leg / np.linalg.norm(mean_leg)))
    angle = math.hypot(tilt[0], tilt[1])
    words = f"turned by {angle:.1f} degrees ({tilt[0]:+.1f} about x, {tilt[1]:+.1f} about y)"
    return Finding("mounting of the IMU", angle > TILTED_DEG, words)
