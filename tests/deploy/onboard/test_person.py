"""Scripts, buttons, sticks and keys mean what their help says."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from humoslope.deploy.contract import Contract, Steering
from humoslope.deploy.onboard.keyboard import Keyboard, keyboard
from humoslope.deploy.onboard.messages import Remote
from humoslope.deploy.onboard.person import Person
from humoslope.deploy.onboard.pilot import Heading, Pilot
from humoslope.deploy.onboard.states import Request
from humoslope.deploy.onboard.unitree_g1 import BUTTONS, MOTORS, bits, motor_of_joint, pressed, require_measured
from humoslope.errors import UserError


@pytest.fixture
def pilot(contract: Contract) -> Pilot:
    return Pilot(contract.commands)  # forward 0 to 0.8 m/s, turns to 0.3 rad/s, no steps to the side


def test_a_button_counts_once_when_it_is_pressed(pilot: Pilot) -> None:
    start = Remote(frozenset({"start"}))
    assert pilot.requests(start) == {Request.START}
    assert pilot.requests(start) == set()
    assert pilot.requests(Remote()) == set()
    assert pilot.requests(start) == {Request.START}
    assert pilot.requests(Remote(frozenset({"A"}))) == {Request.WALK}
    assert pilot.requests(Remote(frozenset({"select", "A"}))) == {Request.STOP}
    assert pilot.requests(Remote(frozenset({"B"}))) == set()
    assert pilot.requests(Remote(frozenset({"B", "L2"}))) == {Request.STOP}


@given(forward=st.floats(-1.0, 1.0), left=st.floats(-1.0, 1.0), turn=st.floats(-1.0, 1.0))
def test_no_stick_leaves_the_ranges_of_the_training(
    contract: Contract, forward: float, left: float, turn: float
) -> None:
    command = Pilot(contract.commands).command(Remote(frozenset(), forward, left, turn))
    commands = contract.commands
    for value, (low, high) in zip(
        command, (commands.forward_m_s, commands.left_m_s, commands.yaw_rate_rad_s), strict=True
    ):
        assert min(low, 0.0) <= value <= max(high, 0.0)


def test_sticks_go_before_keys_and_a_released_stick_means_to_stand(pilot: Pilot) -> None:
    for key in ("up", "up", "left", "x"):
        pilot.press(key)
    assert pilot.requests(Remote()) == set()
    np.testing.assert_allclose(pilot.command(Remote()), [0.2, 0.0, 0.1])
    np.testing.assert_allclose(pilot.command(Remote(forward=1.0)), [0.8, 0.0, 0.0])
    np.testing.assert_allclose(pilot.command(Remote()), 0.0)
    for key in ("up", "0", "down", "right", *["right"] * 9):
        pilot.press(key)
    pilot.requests(Remote())
    np.testing.assert_allclose(pilot.command(Remote()), [0.0, 0.0, -0.3])  # backward is not in the range
    for key, request in (("s", Request.START), ("w", Request.WALK), (" ", Request.STOP), ("q", Request.STOP)):
        pilot.press(key)
        assert pilot.requests(Remote()) == {request}


def test_the_heading_is_held_while_no_turn_is_commanded() -> None:
    steering = Steering("clamp", 0.5, 0.3, 0.3)  # type: ignore[arg-type]
    heading = Heading(steering)

    def facing(yaw: float) -> Any:
        return np.array([math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)])

    ahead = np.array([0.5, 0.0, 0.0])
    np.testing.assert_allclose(heading(ahead, facing(0.4)), ahead)
    np.testing.assert_allclose(heading(ahead, facing(0.2)), [0.5, 0.0, 0.1])
    np.testing.assert_allclose(heading(ahead, facing(2.0)), [0.5, 0.0, -0.3])
    turning = np.array([0.5, 0.0, 0.2])
    np.testing.assert_array_equal(heading(turning, facing(2.0)), turning)
    np.testing.assert_allclose(heading(ahead, facing(3.0)), ahead)  # the new heading
    np.testing.assert_allclose(heading(ahead, facing(-3.2)), [0.5, 0.0, 0.5 * (6.2 - 2.0 * math.pi)])
    np.testing.assert_array_equal(heading(np.zeros(3), facing(1.0)), 0.0)


@given(st.frozensets(st.sampled_from(BUTTONS)))
def test_buttons_come_back_from_their_bits(buttons: frozenset[str]) -> None:
    assert pressed(bits(buttons)) == buttons


def test_joints_find_their_motors_by_name(contract: Contract) -> None:
    assert motor_of_joint(contract) == tuple(range(29))
    turned = replace(contract, joints=contract.joints[::-1])
    assert [MOTORS[motor] for motor in motor_of_joint(turned)] == [joint.name for joint in turned.joints]
    other = replace(contract, joints=(replace(contract.joints[0], name="tail_joint"), *contract.joints[1:]))
    with pytest.raises(
        UserError, match="the policy is for unitree_g1, not for a G1 with 29 motors: it has 'tail_joint'"
    ):
        motor_of_joint(other)


def test_a_policy_that_sees_what_no_robot_measures_is_refused(contract: Contract) -> None:
    require_measured(contract)
    (group,) = contract.observations
    term = replace(group.terms[0], name="base_lin_vel", quantity="root_linear_velocity")
    told = replace(contract, observations=(replace(group, terms=(term,)),))
    with pytest.raises(
        UserError, match=r"sees 'base_lin_vel' \(root_linear_velocity\), which the robot does not measure"
    ):
        require_measured(told)


def test_a_script_is_followed() -> None:
    done: list[str] = []
    robot: Any = SimpleNamespace(
        time=0.0,
        remote=Remote(),
        commands=0,
        lower=lambda: done.append("lower"),
        release=lambda: done.append("release"),
    )
    person = Person("2:release 1:start 1:lower 1.5:forward=0.5")
    seen = []
    for robot.time in (0.0, 1.0, 1.1, 1.3, 1.5, 2.0):
        person.act(robot)
        seen.append((sorted(robot.remote.buttons), robot.remote.forward))
    assert done == ["lower", "release"]
    assert seen == [([], 0.0), (["start"], 0.0), (["start"], 0.0), ([], 0.0), ([], 0.5), ([], 0.5)]


def test_a_person_may_ask_for_the_first_command_until_it_comes() -> None:
    robot: Any = SimpleNamespace(time=0.0, remote=Remote(), commands=0)
    person, seen = Person("1:A", waits=True), []
    for robot.time in (5.0, 5.1, 5.3, 6.0, 6.1, 6.9, 7.1, 7.2):
        robot.commands = int(robot.time >= 6.1)
        person.act(robot)
        seen.append((robot.time, *robot.remote.buttons))
    assert seen == [(5.0, "start"), (5.1, "start"), (5.3,), (6.0, "start"), (6.1,), (6.9,), (7.1, "A"), (7.2, "A")]


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("start", "script: 'start' must be like 1:start"),
        ("1:forward", "script: '1:forward' must be like"),
        ("1:start=2", "script: '1:start=2' must be like"),
        ("1:forward=fast", "script: '1:forward=fast' must be like"),
        ("nan:start", "script: 'nan:start' must be like"),
        ("1:strat", "button, stick or action 'strat' does not exist; did you mean 'start'"),
    ],
)
def test_a_script_that_cannot_be_read_is_refused(script: str, said: str) -> None:
    with pytest.raises(UserError) as error:
        Person(script)
    assert said in str(error.value)


def test_keys_come_one_by_one_and_arrows_by_their_names(tmp_path: Any) -> None:
    import os

    read, write = os.pipe()
    keys = Keyboard(read)
    assert keys.pressed() == []
    os.write(write, b"s\x1b[A\x1b[Cw ")
    assert keys.pressed() == ["s", "up", "right", "w", " "]
    assert keys.pressed() == []
    os.close(read)
    os.close(write)


def test_without_a_terminal_there_are_no_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: False))
    with keyboard() as keys:
        assert keys.pressed() == []
