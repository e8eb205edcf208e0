"""Whether torques, targets and encoders fit together by the contract's gains."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from humoslope.deploy.contract import Contract
from humoslope.deploy.doctor.walk import Finding, Walk
from humoslope.deploy.quantities import Array

GAIN = 0.1
"""Relative error of a gain up to which it counts as the contract's."""
FITS = 0.5
"""Share of a joint's torque, as a root mean square, that may stay unexplained."""
SHARE = 0.95
"""Torques beyond this share of the limit are cut off, and tell nothing of gains."""
LATEST = 5
"""Longest delay that is tried, control steps."""


def check(walk: Walk, contract: Contract) -> list[Finding]:
    """Checks delay, encoders, gains and velocities, in this order; each takes the ones before as found."""
    if not np.abs(walk.torque).max() > 0.0:
        return [Finding("motors", False, "no torques were recorded; nothing can be said")]
    late, delay = _delay(walk, contract)
    owner, sign = _encoders(walk, contract, late)
    findings = [delay, _encoder_finding(contract, owner, sign)]
    position, velocity = walk.joint_pos[:, owner] * sign, walk.joint_vel[:, owner] * sign
    findings.append(_gains(walk, contract, late, position, velocity))
    findings.append(_velocity(walk, contract))
    return findings


def _targets(walk: Walk, late: int) -> tuple[Array, slice]:
    """Targets in force when each measurement was taken, and the rows that have one. Those of a step are in force at the
    measurement of the next one."""
    rows = slice(1 + late, len(walk))
    return walk.target[: len(walk) - 1 - late], rows


def _expected(contract: Contract, target: Array, position: Array, velocity: Array) -> Array:
    kp, kd, limit = (
        np.array([getattr(joint, name) for joint in contract.joints])
        for name in ("stiffness_nm_rad", "damping_nms_rad", "effort_limit_nm")
    )
    return np.clip(kp * (target - position) - kd * velocity, -limit, limit)


def _unexplained(torque: Array, expected: Array) -> Array:
    """Root mean square of the difference over that of the torque, for each joint, [J]."""
    size = np.sqrt(np.square(torque).mean(axis=0))
    return np.asarray(np.sqrt(np.square(torque - expected).mean(axis=0)) / np.maximum(size, 1e-6))


def _delay(walk: Walk, contract: Contract) -> tuple[int, Finding]:
    dt = 1e3 * contract.timing.control_step_s
    rest = []
    for late in range(LATEST + 1):
        target, rows = _targets(walk, late)
        expected = _expected(contract, target, walk.joint_pos[rows], walk.joint_vel[rows])
        rest.append(float(np.median(_unexplained(walk.torque[rows], expected))))
    late = int(np.argmin(rest))
    if late == 0:
        return 0, Finding("delay of commands", False, f"targets act within {dt:g} ms of the message that shows it")
    return late, Finding(
        "delay of commands",
        True,
        f"from a target to the message that shows its torque it takes {late * dt:g} to {(late + 1) * dt:g} ms, "
        f"instead of up to {dt:g} ms",
    )


def _encoders(walk: Walk, contract: Contract, late: int) -> tuple[NDArray[np.int64], Array]:
    """The reported encoder [J] and its sense [J] that explain the torque of each joint best."""
    joints = contract.joints
    target, rows = _targets(walk, late)
    torque, position, velocity = walk.torque[rows], walk.joint_pos[rows], walk.joint_vel[rows]
    owner, sign = np.arange(len(joints)), np.ones(len(joints))
    for j, joint in enumerate(joints):
        best = np.inf
        for sense in (1.0, -1.0):
            expected = joint.stiffness_nm_rad * (target[:, j : j + 1] - sense * position)
            expected = np.clip(
                expected - joint.damping_nms_rad * sense * velocity, -joint.effort_limit_nm, joint.effort_limit_nm
            )
            rest = np.square(torque[:, j : j + 1] - expected).mean(axis=0)
            own = rest[j]
            other = int(np.argmin(rest))
            # Another encoder must be better by far: joints that hardly move look alike.
            candidate, value = (other, rest[other]) if rest[other] < 0.25 * own else (j, own)
            if value < best * (1.0 if sense > 0.0 else 0.25):
                best, owner[j], sign[j] = value, candidate, sense
    return owner, sign


def _encoder_finding(contract: Contract, owner: NDArray[np.int64], sign: Array) -> Finding:
    names = [joint.name for joint in contract.joints]
    moved = [j for j in range(len(names)) if owner[j] != j]
    flipped = [names[j] for j in range(len(names)) if sign[j] < 0.0]
    if not moved and not flipped:
        return Finding("encoders", False, "each encoder moves as the torque of its own motor says")
    words = []
    mirrored = [j for j in moved if _other_side(names[j]) == names[owner[j]]]
    if len(mirrored) > 6:
        words.append(f"left and right are exchanged ({len(mirrored)} joints)")
    elif moved:
        words.append("exchanged: " + ", ".join(f"{names[j]} shows {names[owner[j]]}" for j in moved[:6]))
    if flipped:
        words.append("counting backward: " + ", ".join(flipped[:6]))
    return Finding("encoders", True, "; ".join(words))


def _other_side(name: str) -> str:
    return name.replace("left", "\0").replace("right", "left").replace("\0", "right")


def _gains(walk: Walk, contract: Contract, late: int, position: Array, velocity: Array) -> Finding:
    """Fits torque = a stiffness (target - position) - b damping velocity for each joint."""
    target, rows = _targets(walk, late)
    torque, position, velocity = walk.torque[rows], position[rows], velocity[rows]
    factors = np.full((len(contract.joints), 2), np.nan)
    for j, joint in enumerate(contract.joints):
        free = np.abs(torque[:, j]) < SHARE * joint.effort_limit_nm
        parts = np.stack(
            [
                joint.stiffness_nm_rad * (target[:, j] - position[:, j]),
                -joint.damping_nms_rad * velocity[:, j],
            ],
            axis=1,
        )[free]
        if len(parts) < 20 or not parts.any(axis=0).all():
            continue
        fitted, _, _, _ = np.linalg.lstsq(parts, torque[free, j], rcond=None)
        rest = np.linalg.norm(torque[free, j] - parts @ fitted) / max(np.linalg.norm(torque[free, j]), 1e-9)
        if rest < FITS:
            factors[j] = fitted
    known = ~np.isnan(factors[:, 0])
    if not known.any():
        return Finding("gains", True, "the torques follow no position control")
    stiffness, damping = np.median(factors[known], axis=0)
    off = [
        f"{joint.name} x{factors[j, 0]:.2f}"
        for j, joint in enumerate(contract.joints)
        if known[j] and abs(factors[j, 0] - stiffness) > 3.0 * GAIN
    ]
    words = (
        f"stiffness is {stiffness:.2f} and damping {damping:.2f} times the contract's (median of {known.sum()} joints)"
    )
    wrong = abs(stiffness - 1.0) > GAIN or abs(damping - 1.0) > 2.0 * GAIN
    if off and not wrong:
        words += f"; {', '.join(off[:4])}"
    return Finding("gains", wrong or bool(off), words)


def _velocity(walk: Walk, contract: Contract) -> Finding:
    """Whether velocities are the derivatives of positions: slope of one over the other, over all joints."""
    dt = contract.timing.control_step_s
    # Over a control step the position changes by the mean velocity, of which the trapezium is a good estimate.
    change = np.diff(walk.joint_pos, axis=0) / dt
    mean = 0.5 * (walk.joint_vel[1:] + walk.joint_vel[:-1])
    slope = float((change * mean).sum() / max((change * change).sum(), 1e-12))
    wrong = abs(slope - 1.0) > 0.25
    return Finding("joint velocities", wrong, f"are {slope:.2f} times the rates of the positions")
