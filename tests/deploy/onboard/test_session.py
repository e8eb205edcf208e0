"""A robot is moved, walks and is damped as a person asks, and never by what a guard has not passed."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from dataclasses import replace
from io import StringIO
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from humoslope.cli.deploy import _Sayer
from humoslope.deploy.contract import Contract
from humoslope.deploy.onboard import drive as driving
from humoslope.deploy.onboard.drive import drive
from humoslope.deploy.onboard.guards import Limits
from humoslope.deploy.onboard.messages import Command
from humoslope.deploy.onboard.pace import Pace
from humoslope.deploy.onboard.session import Gate
from humoslope.deploy.onboard.simulated import Faults
from humoslope.deploy.onboard.states import DAMPING_NMS_RAD, Mode
from humoslope.deploy.player import Player
from tests.deploy.onboard.conftest import SCRIPT, SHORT, Stage

pytestmark = pytest.mark.usefixtures("quick")

SOON = 0.2
"""Longest time until the motors are damped, s."""


@pytest.fixture(scope="module")
def walked(stage: Callable[..., Stage]) -> Stage:
    """A walk up 20 degrees from the gantry, and a stop by the remote control."""
    return stage(f"{SCRIPT} 12:select", grade=20.0, hold_heading=True).run(12.5)


def test_it_starts_walks_two_metres_up_a_ramp_and_stops(walked: Stage) -> None:
    assert [text for _, text in walked.said] == [
        "zero torque", "move", "hold", "walk", "damping: stop was asked for"
    ]  # fmt: skip
    x, _, z = walked.robot.world.root_pos
    assert x > 2.0
    assert z > 1.0  # of which 0.75 are its own
    assert walked.damped_at[0] - 12.0 <= SOON
    assert walked.session.gate.slowed == 0  # the guards left the walk alone


def test_every_command_that_was_sent_is_one_of_a_state(walked: Stage, contract: Contract) -> None:
    stiffness = np.array([joint.stiffness_nm_rad for joint in contract.joints])
    for mode, sent in zip(walked.session.ticks.mode, walked.session.ticks.sent, strict=True):
        held = mode in (Mode.MOVE, Mode.HOLD, Mode.WALK)
        np.testing.assert_array_equal(sent.stiffness, stiffness * held)
        assert (sent.damping == DAMPING_NMS_RAD).all() == (mode is Mode.DAMPING)
    targets = [sent.target for sent in walked.session.ticks.sent if sent.stiffness.any()]
    assert max(np.abs(b - a).max() for a, b in itertools.pairwise(targets)) <= Limits().slew_rad_s * 0.02 + 1e-9


def test_the_same_export_walks_as_fast_as_in_play(
    stage: Callable[..., Stage], make_player: Callable[..., Player]
) -> None:
    walk = stage(hold_heading=True).run(3.0)
    start = walk.robot.world.root_pos[0]
    walk.run(7.0)
    trial = make_player(speed=0.5, seconds=6.0).run_trial(np.random.default_rng(0))
    assert (walk.robot.world.root_pos[0] - start) / 4.0 == pytest.approx(trial.speed, rel=0.05)


@pytest.mark.parametrize(
    ("script", "faults", "at", "said"),
    [
        ("", Faults(silent_at_s=1.3), 1.3, "damping: the robot has been silent for 0.1"),
        (" 1.3:select", Faults(), 1.3, "damping: stop was asked for"),
        (" 1.3:L2 1.35:B", Faults(), 1.35, "damping: stop was asked for"),
    ],
)
def test_the_motors_are_damped_soon(
    stage: Callable[..., Stage], script: str, faults: Faults, at: float, said: str
) -> None:
    walk = stage(SHORT + script, faults=faults).run(at + 0.3)
    assert walk.said[-1][1].startswith(said)
    assert 0.0 <= walk.damped_at[0] - at <= SOON


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda walk: setattr(walk.link, "others", True), "somebody else commands the motors, too"),
        (lambda walk: fault(walk, temperature_c=95.0), "the motor of left_hip_pitch_joint has 95 degrees Celsius"),
        (lambda walk: fault(walk, error=7), "the motor of left_hip_pitch_joint reports error 7"),
        (lambda walk: fault(walk, mode_machine=6), "the robot now says mode_machine 6"),
        (lambda walk: fault(walk, corrupt=1.0), "the robot has been silent for"),
        (lambda walk: walk.robot.world.push(np.array([0.0, 4.0, 0.0])), "the robot leans by"),
    ],
)
def test_a_fault_on_the_way_damps_the_motors(
    stage: Callable[..., Stage], change: Callable[[Stage], object], said: str
) -> None:
    walk = stage().run(1.0)
    assert walk.session.state.mode is Mode.WALK
    change(walk)
    walk.run(2.2 if "leans" in said else 1.25)
    assert walk.session.state.reason.startswith(said)
    assert walk.robot.damped


def fault(walk: Stage, **changes: Any) -> None:
    walk.robot.faults = replace(walk.robot.faults, **changes)


def test_lost_and_absurd_messages_now_and_then_do_not_end_a_walk(stage: Callable[..., Stage]) -> None:
    walk = stage(faults=Faults(drop=0.3, corrupt=0.1)).run(2.0)
    assert walk.session.state.mode is Mode.WALK
    assert not walk.session.gate.reason


@pytest.mark.parametrize(
    ("faults", "said"),
    [
        (Faults(mode_machine=6), "the robot says mode_machine 6, but this model is 5"),
        (Faults(imu_tilt_deg=(40.0, 0.0)), "the robot leans by 40 degrees, more than 30"),
        (Faults(silent_at_s=0.0), "the robot has not been heard of"),
        (Faults(flip="left_knee_joint"), "left_knee_joint is 1."),
        (Faults(temperature_c=95.0), "the motor of left_hip_pitch_joint has 95 degrees"),
    ],
)
def test_a_robot_that_is_not_fit_is_never_moved(stage: Callable[..., Stage], faults: Faults, said: str) -> None:
    waiting = stage(faults=faults).run(0.6)
    assert str(waiting.session.hindrance).startswith(said)
    assert not waiting.robot.held


def test_nothing_is_sent_while_somebody_else_commands_the_motors(stage: Callable[..., Stage]) -> None:
    waiting = stage()
    waiting.link.others = True
    waiting.run(0.6)
    assert str(waiting.session.hindrance).startswith("somebody else commands the motors; put the robot into debug mode")
    waiting.session.stop("the program was asked to end")  # nor at the end: it would fight with the other
    assert waiting.robot.commands == 0


def test_a_dry_run_computes_and_sends_nothing(stage: Callable[..., Stage]) -> None:
    run = stage(dry_run=True).run(1.0)
    assert run.session.state.mode is Mode.WALK
    assert np.abs(run.session.ticks.action[-1]).max() > 0.0
    run.session.stop("stop")
    assert run.robot.commands == 0


def test_a_loop_that_stands_still_is_noticed_and_damped_for_good(stage: Callable[..., Stage]) -> None:
    walk = stage().run(1.0)
    walk.link.run(0.03)  # the last tick was 0.02 s before
    assert not walk.session.watch()
    walk.link.run(0.02)
    assert walk.session.watch()
    walk.link.run(0.01)
    assert walk.robot.damped
    walk.run(1.4)
    assert walk.robot.damped
    assert walk.said[-1][1].startswith("damping: the control loop stood still for 0.0")


def test_a_policy_that_is_not_finite_damps_the_motors(stage: Callable[..., Stage]) -> None:
    walk = stage().run(1.0)
    walk.session._controller._policy = lambda inputs: np.full(29, np.nan)  # type: ignore[assignment]
    walk.run(1.1)
    assert walk.session.state.reason == "a command is not a finite number for each joint"
    assert walk.robot.damped


def test_a_closed_gate_lets_nothing_else_through(stage: Callable[..., Stage], contract: Contract) -> None:
    quiet = stage()
    gate = Gate(quiet.link, contract, Limits())
    gate.close("first")
    gate.close("second")
    hold = [np.array([getattr(j, n) for j in contract.joints]) for n in ("stiffness_nm_rad", "damping_nms_rad")]
    sent = gate.send(Command(np.zeros(29), *hold), np.zeros(29))
    assert not sent.stiffness.any()
    assert gate.reason == "first"


def test_a_guardian_hears_nothing_before_the_motors_are_commanded(stage: Callable[..., Stage]) -> None:
    """One that has heard something damps the robot when it hears nothing more."""
    walk, stop = stage(), threading.Event()
    heard: list[Mode] = []
    looked: list[Mode] = []

    def note(modes: list[Mode]) -> bool:
        modes.append(walk.session.state.mode)
        walk.link.run(0.02)
        if len(heard) == 3:
            stop.set()
        return True

    drive(walk.session, stop, Pace(0.01), beat=lambda: note(heard), alive=lambda: note(looked))
    assert set(looked) == {Mode.WAIT}
    assert heard[:3] == [Mode.ZERO_TORQUE] * 3


def test_a_guardian_that_ends_early_ends_a_program_that_waits(stage: Callable[..., Stage]) -> None:
    walk = stage()
    drive(walk.session, threading.Event(), Pace(0.01), alive=lambda: False)
    assert walk.session.state.reason == "the guardian process has ended"
    assert walk.robot.commands == 0


def test_nothing_goes_on_without_a_person_who_is_told_what_to_press(stage: Callable[..., Stage]) -> None:
    walk, text = stage(""), StringIO()
    say = _Sayer(Console(file=text, width=120), SimpleNamespace(now=walk.link.clock))  # type: ignore[arg-type]
    walk.session._say = say.state
    for until, key in ((2.2, "s"), (2.6, "s"), (3.1, "w"), (3.2, "")):
        while walk.link.clock() < until - 1e-6:
            walk.session.tick()
            say.waits(walk.session)
            walk.link.run(0.02)
        assert bool(walk.robot.commands) == (until > 2.2)
        walk.session.pilot.press(key)
    assert [line.split(" s  ")[1] for line in text.getvalue().splitlines()] == [
        "ready: press start (s) to command the motors, which stay limp",
        "zero torque",
        "ready: press start (s) again to move to the default pose",
        "move",
        "hold",
        "ready: press A (w) to walk",
        "walk",
    ]


# In real time: whatever ends the loop, damping is what was sent last.


@pytest.mark.parametrize("ending", ["stop", "failure", "interrupt", "guardian"])
def test_however_the_loop_ends_the_motors_are_damped(
    stage: Callable[..., Stage], monkeypatch: pytest.MonkeyPatch, ending: str
) -> None:
    monkeypatch.setattr(driving, "DAMPED_S", 0.01)
    walk, stop = stage().run(0.5), threading.Event()
    assert walk.session.state.mode is Mode.MOVE
    beats = 0

    def beat() -> bool:
        nonlocal beats
        beats += 1
        walk.link.run(0.02)
        if beats == 3 and ending == "stop":
            stop.set()
        if beats == 3 and ending == "failure":
            raise RuntimeError("bug")
        if beats == 3 and ending == "interrupt":
            raise KeyboardInterrupt
        return not (beats == 3 and ending == "guardian")

    pace = Pace(0.01)  # the loop need not wait for the time of day
    if ending in ("failure", "interrupt"):
        with pytest.raises(RuntimeError if ending == "failure" else KeyboardInterrupt):
            drive(walk.session, stop, pace, beat=beat)
    else:
        drive(walk.session, stop, pace, beat=beat)
    walk.link.run(0.01)
    assert walk.robot.damped
    assert walk.session.over
    assert (
        walk.session.state.reason
        == {
            "stop": "the program was asked to end",
            "failure": "the program failed",
            "interrupt": "the program was interrupted",
            "guardian": "the guardian process has ended",
        }[ending]
    )
