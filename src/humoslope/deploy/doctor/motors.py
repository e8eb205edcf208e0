"""Whether torques, targets and encoders fit together by the contract's gains."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from humoslope.deploy.contract import Contract, Joint
from humoslope.deploy.doctor.walk import Finding, Walk
from humoslope.deploy.quantities import Array

GAIN = 0.1
"""Relative error of a gain up to which it counts as the contract's."""
EXPLAINED = 0.04
"""Share of a motor's torque, as a mean square, that an encoder of another joint may leave unexplained."""
FITS = 0.5
"""Share of a joint's torque, as a root mean square, that may stay unexplained."""
WELL = 0.2
"""Share of a joint's torque, as a root mean square, that may stay unexplained by its own encoder if it is the right
one."""
FEWEST = 20
"""Smallest number of control steps for a fit."""
SHARE = 0.95
"""Torques beyond this share of the limit are cut off, and tell nothing of gains."""
LATEST = 5
"""Longest delay that is tried, control steps."""


def check(walk: Walk, contract: Contract) -> list[Finding]:
    """Checks velocities, delay, encoders and gains; each takes the ones before as found."""
    factor, velocities = _velocity(walk, contract)
    if not np.abs(walk.torque).max() > 0.0:
        return [velocities, Finding("motors", False, "no torques were recorded; nothing more can be said")]
    walk = dataclasses.replace(walk, joint_vel=walk.joint_vel / factor)
    explained = [_explain(walk, contract, late) for late in range(LATEST + 1)]
    late = int(np.argmin([rest for _, _, rest in explained]))
    owner, sign, _ = explained[late]
    gains = _gains(walk, contract, late, walk.joint_pos[:, owner] * sign, walk.joint_vel[:, owner] * sign)
    return [velocities, _delay_finding(contract, late), _encoder_finding(contract, owner, sign), gains]


def _targets(walk: Walk, late: int) -> tuple[Array, slice]:
    """Targets in force when each measurement was taken, and the rows that have one. Those of a step are in force at the
    measurement of the next one."""
    rows = slice(1 + late, len(walk))
    return walk.target[: len(walk) - 1 - late], rows


def _delay_finding(contract: Contract, late: int) -> Finding:
    dt = 1e3 * contract.timing.control_step_s
    words = f"from a target to the message that shows its torque it takes {late * dt:g} to {(late + 1) * dt:g} ms"
    return Finding("delay", late > 0, words if late == 0 else f"{words}, instead of up to {dt:g} ms")


def _explain(walk: Walk, contract: Contract, late: int) -> tuple[NDArray[np.int64], Array, float]:
    """Explains torques by encoders: the encoder [J] and its sense [J] for each motor, and the share of the torque, a
    root mean square, that stays unexplained (median over joints)."""
    joints = contract.joints
    target, rows = _targets(walk, late)
    torque, position, velocity = walk.torque[rows], walk.joint_pos[rows], walk.joint_vel[rows]
    # Gains that are out on the whole must not make encoders look exchanged.
    own = _fitted(walk, contract, late, walk.joint_pos, walk.joint_vel, WELL)
    known = ~np.isnan(own[:, 0])
    factors = np.median(own[known], axis=0) if known.mean() >= 0.5 else np.ones(2)
    owner, sign, left = np.arange(len(joints)), np.ones(len(joints)), np.zeros(len(joints))
    for j, joint in enumerate(joints):
        power = max(float(np.square(torque[:, j]).mean()), 1e-9)
        rest = np.stack(
            [_rest(joint, factors, target[:, j], torque[:, j], sense, position, velocity) for sense in (1.0, -1.0)]
        )
        backward, other = divmod(int(np.argmin(rest)), len(joints))
        # Another encoder must explain the torque well, and far better: joints that hardly move look alike.
        if rest[backward, other] > EXPLAINED * power or rest[backward, other] > 0.25 * rest[0, j]:
            backward, other = 0, j
        sign[j], owner[j] = (-1.0 if backward else 1.0), other
        left[j] = np.sqrt(rest[backward, other] / power)
    return owner, sign, float(np.median(left))


def _rest(
    joint: Joint, factors: Array, target: Array, torque: Array, sense: float, position: Array, velocity: Array
) -> Array:
    """Mean square of what each encoder [J], counting in this sense, leaves unexplained of a motor's torque [T]."""
    stiffness, damping = factors * [joint.stiffness_nm_rad, joint.damping_nms_rad]
    pull = stiffness * (target[:, None] - sense * position) - damping * sense * velocity
    limited = np.clip(pull, -joint.effort_limit_nm, joint.effort_limit_nm)
    return np.asarray(np.square(torque[:, None] - limited).mean(axis=0))


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


def _fitted(walk: Walk, contract: Contract, late: int, position: Array, velocity: Array, fits: float) -> Array:
    """Factors on stiffness and damping that explain the torque of each joint, [J, 2]; NaN where none do.

    Args:
        walk: The walk.
        contract: The contract.
        late: Delay, control steps.
        position: [T, J] position of each joint, rad.
        velocity: [T, J] velocity of each joint, rad/s.
        fits: Share of the torque, as a root mean square, that may stay unexplained.
    """
    target, rows = _targets(walk, late)
    torque, position, velocity = walk.torque[rows], position[rows], velocity[rows]
    factors = np.full((len(contract.joints), 2), np.nan)
    for j, joint in enumerate(contract.joints):
        free = np.abs(torque[:, j]) < SHARE * joint.effort_limit_nm
        parts = np.stack(
            [joint.stiffness_nm_rad * (target[:, j] - position[:, j]), -joint.damping_nms_rad * velocity[:, j]], axis=1
        )[free]
        if len(parts) < FEWEST or not parts.any(axis=0).all():
            continue
        factor, _, _, _ = np.linalg.lstsq(parts, torque[free, j], rcond=None)
        size = float(np.linalg.norm(torque[free, j]))
        if float(np.linalg.norm(torque[free, j] - parts @ factor)) < fits * max(size, 1e-9):
            factors[j] = factor
    return factors


def _gains(walk: Walk, contract: Contract, late: int, position: Array, velocity: Array) -> Finding:
    factors = _fitted(walk, contract, late, position, velocity, FITS)
    known = ~np.isnan(factors[:, 0])
    if not known.any():
        return Finding("gains", True, "the torques follow no position control")
    stiffness, damping = np.median(factors[known], axis=0)
    off = [
        f"{joint.name} x{factors[j, 0]:.2f}"
        for j, joint in enumerate(contract.joints)
        if known[j] and abs(factors[j, 0] - stiffness) > 3.0 * GAIN
    ]
    count = int(known.sum())
    words = f"stiffness is {stiffness:.2f} and damping {damping:.2f} times the contract's (median of {count} joints)"
    wrong = abs(stiffness - 1.0) > GAIN or abs(damping - 1.0) > 2.0 * GAIN
    if off and not wrong:
        words += f"; {', '.join(off[:4])}"
    return Finding("gains", wrong or bool(off), words)


def _velocity(walk: Walk, contract: Contract) -> tuple[float, Finding]:
    """How many times the rates of positions the velocities are, over all joints; 1 where that is about right."""
    dt = contract.timing.control_step_s
    # Over a control step the position changes by the mean velocity, of which the trapezium is a good estimate.
    change = np.diff(walk.joint_pos, axis=0) / dt
    mean = 0.5 * (walk.joint_vel[1:] + walk.joint_vel[:-1])
    slope = float((change * mean).sum() / max(float((change * change).sum()), 1e-12))
    wrong = abs(slope - 1.0) > 0.25
    usable = wrong and abs(slope) > 0.01
    return slope if usable else 1.0, Finding(
        "joint velocities", wrong, f"are {slope:.2f} times the rates of the positions"
    )
