"""Guards between a policy and the motors: pure functions that return a sentence about what is wrong, or None."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from humoslope.deploy import rotation
from humoslope.deploy.contract import Contract
from humoslope.deploy.onboard.messages import Command, Reading
from humoslope.deploy.quantities import Array, Measured
from humoslope.ranges import Checked, Count, Positive, Range

Tilt = Annotated[float, Range(0.0, 90.0, open_low=True, open_high=True)]


@dataclass(frozen=True)
class Limits(Checked):
    """Limits beyond which the motors are damped. The defaults let the shipped policies walk untouched.

    Attributes:
        tilt_deg: Largest tilt of the root while it is held or walks, degrees.
        start_tilt_deg: Largest tilt of the root at the start, degrees.
        start_pose_rad: Largest distance of a joint from its default at the start, rad.
        slew_rad_s: Largest rate of a joint's target, rad/s; faster targets are slowed down. Shipped: up to 36.
        stop_torque: Share of its effort limit with which a target beyond a joint's range may push against the stop;
            targets further out are moved in. Shipped: up to 0.33.
        silent_s: Longest time without a new message of the robot, s.
        missed_ticks: Number of control steps without a command after which the motors are damped.
        hottest_c: Highest temperature of a motor, degrees Celsius.
    """

    VERB: ClassVar[str] = "limits"

    tilt_deg: Tilt = 57.0
    start_tilt_deg: Tilt = 30.0
    start_pose_rad: Positive = 1.0
    slew_rad_s: Positive = 50.0
    stop_torque: Positive = 0.5
    silent_s: Positive = 0.1
    missed_ticks: Count = 3
    hottest_c: Positive = 90.0


def tilt_deg(quat_w: Array) -> float:
    """Returns the angle between an IMU's z axis and the vertical, degrees."""
    upright = float(rotation.up_b(quat_w / np.linalg.norm(quat_w))[2])
    return math.degrees(math.acos(min(1.0, max(-1.0, upright))))


def unfit_to_start(reading: Reading, contract: Contract, limits: Limits, mode_machine: int) -> str | None:
    """Says why the robot must not be moved from where it is."""
    if (said := unfit(reading, contract, limits)) is not None:
        return said
    if reading.mode_machine != mode_machine:
        return (
            f"the robot says mode_machine {reading.mode_machine}, but this model is {mode_machine}; "
            "another build has other joints"
        )
    if (tilt := tilt_deg(reading.quat_w)) > limits.start_tilt_deg:
        return f"the robot leans by {tilt:.0f} degrees, more than {limits.start_tilt_deg:g}; hang it upright"
    away = np.abs(reading.joint_pos - [joint.default_rad for joint in contract.joints])
    worst = int(np.argmax(away))
    if away[worst] > limits.start_pose_rad:
        return (
            f"{contract.joints[worst].name} is {away[worst]:.2f} rad from its default, more than "
            f"{limits.start_pose_rad:g}; bring it closer by hand"
        )
    return None


def unfit(reading: Reading, contract: Contract, limits: Limits, tilt: bool = False) -> str | None:
    """Says why the robot must not go on.

    Args:
        reading: Newest message.
        contract: The contract.
        limits: The limits.
        tilt: Whether the robot is to be upright by now.
    """
    if not reading.usable:
        return "the robot sent numbers that cannot be"
    worst = int(np.argmax(reading.temperature))
    if reading.temperature[worst] > limits.hottest_c:
        return (
            f"the motor of {contract.joints[worst].name} has {reading.temperature[worst]:.0f} degrees Celsius, "
            f"more than {limits.hottest_c:g}"
        )
    if reading.errors.any():
        worst = int(np.argmax(reading.errors != 0))
        return f"the motor of {contract.joints[worst].name} reports error {reading.errors[worst]:.0f}"
    if tilt and (angle := tilt_deg(reading.quat_w)) > limits.tilt_deg:
        return f"the robot leans by {angle:.0f} degrees, more than {limits.tilt_deg:g}"
    return None


def allowed(target: Array, before: Array, contract: Contract, limits: Limits) -> Array:
    """Returns the targets [J] that are passed on: near enough to the ones before, and not far beyond a joint's range.

    Args:
        target: [J] wanted targets, rad.
        before: [J] targets of the control step before, rad.
        contract: The contract.
        limits: The limits.
    """
    most = limits.slew_rad_s * contract.timing.control_step_s
    inside = np.clip(target, *_ends(contract, limits))
    return np.clip(inside, before - most, before + most)


def _ends(contract: Contract, limits: Limits) -> tuple[Array, Array]:
    """Lowest and highest target [J] of each joint, rad: so far beyond its stop that a target pushes against it with the
    allowed share of the effort limit."""
    joints = contract.joints
    low, high = np.array([joint.range_rad for joint in joints]).T
    beyond = np.array([limits.stop_torque * j.effort_limit_nm / max(j.stiffness_nm_rad, 1e-9) for j in joints])
    return low - beyond, high + beyond


def unsendable(command: Command, contract: Contract, limits: Limits, damping: float) -> str | None:
    """Says why a command must not reach the motors, whatever it was computed from. The last check before the link.

    Args:
        command: The command.
        contract: The contract.
        limits: The limits.
        damping: Derivative gain of the state that damps, Nm s/rad.
    """
    joints = contract.joints
    arrays = (command.target, command.stiffness, command.damping)
    if any(array.shape != (len(joints),) or not np.isfinite(array).all() for array in arrays):
        return "a command is not a finite number for each joint"
    if not command.stiffness.any():
        if (command.damping < 0.0).any() or (command.damping > damping).any():
            return "a command without stiffness has a foreign damping"
        return None
    kp, kd = (np.array([getattr(j, name) for j in joints]) for name in ("stiffness_nm_rad", "damping_nms_rad"))
    if not (np.array_equal(command.stiffness, kp) and np.array_equal(command.damping, kd)):
        return "a command has gains other than the contract's"
    low, high = _ends(contract, limits)
    if (command.target < low - 1e-6).any() or (command.target > high + 1e-6).any():
        return "a target lies too far beyond the range of its joint"
    return None


def measured(reading: Reading, contract: Contract, command: Array, last_action: Array) -> Measured:
    """Returns a message as what an observation is made of."""
    return Measured(
        root_quat_w=reading.quat_w / np.linalg.norm(reading.quat_w),
        root_ang_vel_b=reading.ang_vel_b,
        joint_pos_rel=reading.joint_pos - [joint.default_rad for joint in contract.joints],
        joint_vel=reading.joint_vel,
        command=command,
        last_action=last_action,
    )
