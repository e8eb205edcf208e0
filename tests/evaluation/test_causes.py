"""The first cause of a failure is the first thing that went wrong before the robot began to tip."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from humoslope.evaluation import causes
from humoslope.evaluation.causes import SIDES, SIGNALS, count, first_cause, first_causes

DT = 0.02
ROWS = 75
TIP = 45
"""Row from which the robot tips in these tests, 0.6 s before the end."""

Moments = dict[str, np.ndarray]


def walking(tips: bool = True) -> Moments:
    """Signals of a walk: feet that bear the robot in turn and stick, and then the last lean."""
    moments = {name: np.zeros(ROWS) for name in SIGNALS}
    time = DT * np.arange(ROWS)
    moments["tilt"] = np.radians(8.0 - 2.0 * np.cos(2.0 * math.pi * (time - DT * TIP) / 0.8))
    if tips:
        since = ((np.arange(ROWS) - TIP) / (ROWS - 1 - TIP)).clip(0.0)
        moments["tilt"] = np.where(since > 0.0, moments["tilt"][TIP] + np.radians(62.0) * since**2, moments["tilt"])
    moments["torque_use"][:] = 0.6
    moments["joint_margin"][:] = 0.2
    moments["friction"][:] = 0.8
    for i, side in enumerate(SIDES):
        stance = np.floor(time / 0.4).astype(int) % 2 == i
        moments[f"foot_load_{side}"] = np.where(stance, 1.0, 0.0)
        moments[f"foot_drag_{side}"] = np.where(stance, 0.2, 0.0)
        moments[f"foot_speed_{side}"] = np.where(stance, 0.05, 1.2)
    return moments


def during(moments: Moments, first: int, last: int, **values: float) -> Moments:
    """The signals with other values from row `first` to row `last`."""
    changed = {name: array.copy() for name, array in moments.items()}
    for name, value in values.items():
        changed[name][first : last + 1] = value
    return changed


SLIDES = {"foot_load_left": 0.6, "foot_drag_left": 0.48, "foot_speed_left": 0.8}
STUCK = {"foot_load_right": 0.05, "foot_drag_right": 0.5, "foot_speed_right": 0.6}


@pytest.mark.parametrize(
    ("values", "cause", "said"),
    [
        (SLIDES, causes.SLIP, "the left foot slides by 21 cm"),
        ({"shin_load": 0.4}, causes.STUMBLE, "a shin is on the ground"),
        (STUCK, causes.STUMBLE, "the right foot runs against the ground"),
        ({"torque_use": 1.0}, causes.TORQUE, "a motor is at its limit"),
        ({"joint_margin": -0.01}, causes.JOINT, "a joint is at its end"),
    ],
)
def test_what_went_wrong_before_the_robot_tipped_is_the_cause(values: dict[str, float], cause: str, said: str) -> None:
    found = first_cause(during(walking(), 34, 46, **values), DT)
    assert (found.cause, found.text) == (cause, said)
    assert found.before_s == pytest.approx((ROWS - 1 - 34) * DT)


def test_a_robot_that_tips_with_everything_in_its_limits_has_tipped() -> None:
    found = first_cause(walking(), DT)
    assert found.cause == causes.TIP
    assert found.before_s == pytest.approx((ROWS - 1 - TIP) * DT, abs=4 * DT)  # it begins slowly
    assert "tips over from a lean of" in found.text


@pytest.mark.parametrize(
    ("values", "after"),
    [(SLIDES, 14), (STUCK, 14), ({"shin_load": 0.4}, 14), ({"torque_use": 1.0}, 2), ({"joint_margin": -0.01}, 2)],
)
def test_what_follows_from_tipping_is_no_cause(values: dict[str, float], after: int) -> None:
    assert first_cause(during(walking(), TIP + after, ROWS - 1, **values), DT).cause == causes.TIP


def test_feet_may_give_way_while_the_robot_begins_to_lean() -> None:
    assert first_cause(during(walking(), TIP + 6, ROWS - 1, **SLIDES), DT).cause == causes.SLIP


@pytest.mark.parametrize("values", [SLIDES, {"shin_load": 0.4}, {"torque_use": 1.0}, {"joint_margin": -0.01}])
def test_what_was_survived_a_step_ago_is_no_cause(values: dict[str, float]) -> None:
    assert first_cause(during(walking(), 5, 14, **values), DT).cause == causes.TIP


def test_what_began_long_ago_and_lasted_is_the_cause() -> None:
    found = first_cause(during(walking(), 0, ROWS - 1, torque_use=1.0), DT)
    assert found.cause == causes.TORQUE
    assert found.before_s == pytest.approx((ROWS - 1) * DT)


def test_of_two_causes_the_first_counts() -> None:
    slip_first = during(during(walking(), 34, 38, **SLIDES), 37, 46, torque_use=1.0)
    torque_first = during(during(walking(), 38, 42, **SLIDES), 30, 46, torque_use=1.0)
    assert first_cause(slip_first, DT).cause == causes.SLIP
    assert first_cause(torque_first, DT).cause == causes.TORQUE


@pytest.mark.parametrize(
    ("rows", "values"),
    [
        ((40, 42), {"torque_use": 1.0}),  # the peak of a landing
        ((38, 45), {"joint_margin": 0.0}),  # a leg that is stretched in a step
        ((20, 40), {"joint_margin": 0.0}),  # it was bent again before the robot leaned
        ((38, 43), SLIDES | {"foot_load_left": 0.1, "foot_drag_left": 0.08}),  # a foot that touches down or takes off
        ((38, 43), SLIDES | {"foot_drag_left": 0.2}),  # within the friction cone it rolls, and does not slide
        ((38, 43), SLIDES | {"foot_speed_left": 0.15}),
        ((42, 43), SLIDES),  # 3 cm
        ((38, 43), {"foot_load_right": 0.05, "foot_drag_right": 0.08}),  # a foot that brushes the ground
        (
            (38, 43),
            {"foot_load_right": 0.5, "foot_drag_right": 0.5, "foot_speed_right": 0.0},
        ),  # not far beyond the cone
        ((38, 43), STUCK | {"foot_speed_right": 0.1}),  # a foot that stands on an edge
        ((38, 43), {"shin_load": 0.02}),
    ],
)
def test_what_happens_in_every_walk_is_no_cause(rows: tuple[int, int], values: dict[str, float]) -> None:
    assert first_cause(during(walking(), *rows, **values), DT).cause == causes.TIP


def test_a_robot_that_sinks_without_a_cause_is_unclear_and_with_one_it_is_not() -> None:
    assert first_cause(walking(tips=False), DT).cause == causes.UNCLEAR
    assert first_cause(during(walking(tips=False), 60, ROWS - 1, torque_use=1.0), DT).cause == causes.TORQUE


def test_a_trial_shorter_than_the_window_is_judged_by_what_there_is() -> None:
    late = during(walking(), 0, 19, **dict.fromkeys(SIGNALS, np.nan))
    found = first_cause(during(late, 38, 43, **SLIDES), DT)
    assert (found.cause, found.before_s) == (causes.SLIP, pytest.approx((ROWS - 1 - 38) * DT))
    assert first_cause({name: np.full(ROWS, np.nan) for name in SIGNALS}, DT).cause == causes.UNRECORDED
    assert first_cause({name: values[-1:] for name, values in walking().items()}, DT).cause == causes.TIP


@given(scale=st.floats(0.2, 3.0), ahead=st.integers(0, 20))
def test_the_cause_does_not_depend_on_the_control_rate(scale: float, ahead: int) -> None:
    def seen(dt: float) -> tuple[str, float]:
        time = np.arange(0.0, 1.5, dt)
        own = DT * np.arange(ROWS)
        slipped = during(walking(), 30 - ahead // 2, 44, **SLIDES)
        found = first_cause({name: np.interp(time, own, values) for name, values in slipped.items()}, dt)
        return found.cause, found.before_s

    (cause, before), (other, other_before) = seen(DT), seen(DT / (1.0 + 0.5 * scale))
    assert cause == other == causes.SLIP
    assert before == pytest.approx(other_before, abs=0.05)


def test_trials_are_counted_by_cause_and_successes_are_not() -> None:
    quiet, slipped = walking(), during(walking(), 38, 43, **SLIDES)
    moments = {name: np.stack([quiet[name], slipped[name], quiet[name], quiet[name], quiet[name]]) for name in SIGNALS}
    ended = {
        "fell": np.array([True, True, False, False, False]),
        "left": np.array([False, False, True, False, False]),
        "timed_out": np.array([False, False, False, True, False]),
    }
    found = first_causes(moments, DT, **ended)
    assert found == [causes.TIP, causes.SLIP, causes.OFF_TRACK, causes.OUT_OF_TIME, ""]
    assert count(found) == {causes.SLIP: 1, causes.TIP: 1, causes.OFF_TRACK: 1, causes.OUT_OF_TIME: 1}
    assert first_causes({}, DT, **ended)[:2] == [causes.UNRECORDED] * 2


def test_every_cause_has_its_meaning() -> None:
    assert set(causes.MEANING) == set(causes.CAUSES)
