"""No number passes that could hurt the robot, and what walks is not touched."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from humoslope.deploy.contract import Contract
from humoslope.deploy.onboard import guards
from humoslope.deploy.onboard.guards import Limits, allowed, tilt_deg, unfit, unfit_to_start, unsendable
from humoslope.deploy.onboard.messages import Command, Inbox, Reading, Remote
from humoslope.deploy.onboard.states import DAMPING_NMS_RAD, damping
from humoslope.errors import UserError

LIMITS = Limits()
numbers = st.floats(allow_nan=True, allow_infinity=True, width=32)


@pytest.fixture(scope="module")
def standing(contract: Contract) -> Reading:
    """A robot that stands upright in its default pose."""
    joints = len(contract.joints)
    return Reading(
        count=1,
        quat_w=np.array([1.0, 0.0, 0.0, 0.0]),
        ang_vel_b=np.zeros(3),
        joint_pos=np.array([joint.default_rad for joint in contract.joints]),
        joint_vel=np.zeros(joints),
        torque=np.zeros(joints),
        temperature=np.full(joints, 30.0),
        errors=np.zeros(joints),
        mode_machine=5,
        remote=Remote(),
    )


def leaning(degrees: float, about: int = 1) -> np.ndarray:
    half = 0.5 * math.radians(degrees)
    quat = np.array([math.cos(half), 0.0, 0.0, 0.0])
    quat[1 + about] = math.sin(half)
    return quat


def put(values: np.ndarray, index: int, value: float) -> np.ndarray:
    result = values.copy()
    result[index] = value
    return result


@pytest.mark.parametrize("about", [0, 1])
@given(degrees=st.floats(-179.0, 179.0))
def test_tilt_is_the_angle_to_the_vertical_and_yaw_is_none(about: int, degrees: float) -> None:
    assert tilt_deg(leaning(degrees, about)) == pytest.approx(abs(degrees), abs=1e-5)
    assert tilt_deg(leaning(degrees, 2)) == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({}, None),
        ({"quat_w": leaning(29.0)}, None),
        ({"quat_w": leaning(31.0)}, "the robot leans by 31 degrees, more than 30; hang it upright"),
        ({"mode_machine": 6}, "the robot says mode_machine 6, but this model is 5"),
        ({"joint_pos": (3, 1.8)}, "left_knee_joint is 1.13 rad from its default, more than 1; bring it closer"),
        ({"joint_pos": (3, math.nan)}, "the robot sent numbers that cannot be"),
        ({"quat_w": np.zeros(4)}, "the robot sent numbers that cannot be"),
        ({"temperature": (3, 91.0)}, "the motor of left_knee_joint has 91 degrees Celsius, more than 90"),
        ({"errors": (3, 2.0)}, "the motor of left_knee_joint reports error 2"),
    ],
)
def test_what_speaks_against_a_start(
    standing: Reading, contract: Contract, change: dict[str, Any], said: str | None
) -> None:
    values = {
        name: put(getattr(standing, name), *value) if isinstance(value, tuple) else value
        for name, value in change.items()
    }
    found = unfit_to_start(replace(standing, **values), contract, LIMITS, 5)
    assert found is said is None or (found is not None and said is not None and found.startswith(said))


def test_a_robot_that_is_not_yet_to_stand_may_lean(standing: Reading, contract: Contract) -> None:
    lying = replace(standing, quat_w=leaning(80.0))
    assert unfit(lying, contract, LIMITS) is None
    assert unfit(lying, contract, LIMITS, tilt=True) == "the robot leans by 80 degrees, more than 57"


@given(st.lists(st.floats(-1e3, 1e3), min_size=29, max_size=29), st.floats(-1.0, 1.0))
def test_targets_are_neither_too_fast_nor_far_beyond_the_stops(
    contract: Contract, wanted: list[float], before: float
) -> None:
    start = np.array([joint.default_rad for joint in contract.joints]) * (1.0 + before)
    passed = allowed(np.array(wanted), start, contract, LIMITS)
    assert np.abs(passed - start).max() <= LIMITS.slew_rad_s * 0.02 + 1e-12
    for joint, target in zip(contract.joints, passed, strict=True):
        low, high = joint.range_rad
        # Against its stop, at rest, the motor gives at most the allowed share of its effort limit.
        push = joint.stiffness_nm_rad * max(target - high, low - target)
        assert push <= LIMITS.stop_torque * joint.effort_limit_nm + 1e-9
    near = np.clip(np.array(wanted), start - 0.05, start + 0.05)
    np.testing.assert_array_equal(allowed(near, start, contract, LIMITS), near)  # and what is neither, is not touched


@given(
    st.lists(numbers, min_size=29, max_size=29),
    st.lists(numbers, min_size=29, max_size=29),
    st.lists(numbers, min_size=29, max_size=29),
)
def test_no_command_of_arbitrary_numbers_is_sendable(
    contract: Contract, target: list[float], stiffness: list[float], dampings: list[float]
) -> None:
    command = Command(*map(np.array, (target, stiffness, dampings)))
    if unsendable(command, contract, LIMITS, DAMPING_NMS_RAD) is None:  # then it is limp, or gently damped
        assert not command.stiffness.any()
        assert (command.damping >= 0.0).all()
        assert (command.damping <= DAMPING_NMS_RAD).all()


def test_only_the_contracts_gains_hold_a_joint(contract: Contract) -> None:
    kp, kd, q = (
        np.array([getattr(joint, name) for joint in contract.joints])
        for name in ("stiffness_nm_rad", "damping_nms_rad", "default_rad")
    )
    assert unsendable(Command(q, kp, kd), contract, LIMITS, DAMPING_NMS_RAD) is None
    assert unsendable(damping(contract), contract, LIMITS, DAMPING_NMS_RAD) is None
    for command, said in (
        (Command(q, put(kp, 3, 400.0), kd), "gains other than the contract's"),
        (Command(q, kp, put(kd, 3, 0.0)), "gains other than the contract's"),
        (Command(put(q, 3, 5.0), kp, kd), "too far beyond the range"),
        (Command(put(q, 3, math.nan), kp, kd), "not a finite number"),
        (Command(q[:28], kp, kd), "not a finite number for each joint"),
        (Command(q, 0.0 * kp, put(kd, 3, 40.0)), "a foreign damping"),
    ):
        assert said in str(unsendable(command, contract, LIMITS, DAMPING_NMS_RAD))


def test_limits_that_are_none_are_refused() -> None:
    with pytest.raises(UserError, match="limits: slew_rad_s is 0; it must be positive"):
        Limits(slew_rad_s=0.0)
    with pytest.raises(UserError, match="tilt_deg is .*; it must be between 0 and 90, both excluded"):
        Limits(tilt_deg=120.0)


def test_unusable_messages_are_not_taken(standing: Reading) -> None:
    inbox = Inbox()
    assert inbox.read(0.0, 0.0) is None
    for k in range(4):
        bad = {"joint_vel": put(standing.joint_vel, 0, math.inf)} if k == 2 else {}
        inbox.add(0.1 * k, replace(standing, count=k, **bad))
    newest = inbox.read(0.3, 0.0)
    assert newest is not None
    assert newest.count == 3
    assert [getattr(inbox.read(0.3, age), "count", None) for age in (0.05, 0.1, 0.15, 0.2, 0.3, 9.0)] == [
        1,
        1,
        1,
        1,
        0,
        0,
    ]
    assert inbox.refused == 1


def test_what_an_observation_is_made_of(standing: Reading, contract: Contract) -> None:
    moved = replace(standing, joint_pos=standing.joint_pos + 0.1, quat_w=1.001 * leaning(30.0))
    measured = guards.measured(moved, contract, np.ones(3), np.zeros(29))
    np.testing.assert_allclose(measured.joint_pos_rel, 0.1)
    np.testing.assert_allclose(measured.up_b, [-0.5, 0.0, math.cos(math.radians(30.0))], atol=1e-9)
