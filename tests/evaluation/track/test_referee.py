"""A trial ends by the protocol's rules, each at its own limit."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from humoslope.evaluation.track.protocol import HeldOutProtocol
from humoslope.evaluation.track.referee import OUTCOMES, Referee, Situation

DT = 0.02


def situation(**changes: Any) -> Situation:
    """A robot that walks in the middle of the track."""
    walking = {
        "place": 10.0,
        "across": 0.0,
        "com_height": 0.65,
        "upright": 1.0,
        "upper_force": 0.0,
        "diverged": False,
        "steps": 1000,
    }
    return Situation(**{name: torch.tensor([value]) for name, value in (walking | changes).items()})


def referee() -> Referee:
    return Referee(HeldOutProtocol(), half_width=3.0, dt=DT)


def outcome(verdict: Tensor) -> str:
    assert verdict.sum() <= 1
    return next((name for name, holds in zip(OUTCOMES, verdict[0].tolist(), strict=True) if holds), "goes on")


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, "goes on"),
        ({"place": 31.499}, "goes on"),
        ({"place": 31.5}, "success"),
        ({"across": 2.99}, "goes on"),
        ({"across": 3.01}, "left"),
        ({"across": -3.01}, "left"),
        ({"place": -0.01}, "left"),
        ({"upright": math.cos(math.radians(69.0))}, "goes on"),
        ({"upright": math.cos(math.radians(71.0))}, "fell"),
        ({"com_height": 0.26}, "goes on"),
        ({"com_height": 0.24}, "fell"),
        ({"diverged": True, "place": 40.0}, "fell"),
        ({"steps": 6999}, "goes on"),
        ({"steps": 7000}, "timed_out"),
        ({"place": 31.5, "com_height": 0.2, "steps": 7000}, "success"),
        ({"across": 3.1, "upright": 0.0}, "fell"),
        ({"across": 3.1, "steps": 7000}, "left"),
    ],
)
def test_each_rule_holds_from_its_limit_on(changes: dict[str, Any], expected: str) -> None:
    assert outcome(referee().judge(situation(**changes))) == expected


def play(forces: list[float]) -> list[str]:
    judge = referee()
    return [outcome(judge.judge(situation(upper_force=force))) for force in forces]


def test_touching_the_ground_is_a_fall_after_a_tenth_of_a_second() -> None:
    assert play([5.0] * 5) == ["goes on"] * 4 + ["fell"]


def test_a_touch_that_is_broken_off_starts_anew() -> None:
    assert set(play([5.0] * 4 + [0.5] + [5.0] * 4)) == {"goes on"}


def test_a_new_trial_does_not_inherit_the_touch_of_the_last() -> None:
    judge = referee()
    for _ in range(4):
        judge.judge(situation(upper_force=5.0))
    judge.reset(torch.tensor([True]))
    assert outcome(judge.judge(situation(upper_force=5.0))) == "goes on"


@given(steps=st.integers(1, 20_000), dt=st.sampled_from([0.01, 0.02, 0.025, 1.0 / 60.0]))
def test_a_time_limit_is_met_at_its_own_control_step(steps: int, dt: float) -> None:
    judge = Referee(HeldOutProtocol(timeout_s=steps * dt), half_width=3.0, dt=dt)
    assert [outcome(judge.judge(situation(steps=n))) for n in (steps - 1, steps)] == ["goes on", "timed_out"]
