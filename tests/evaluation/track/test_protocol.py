"""The protocol's numbers are the paper's, and an impossible one is refused in a sentence."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.evaluation.track.protocol import HeldOutProtocol, sweep_protocol

PAPER = HeldOutProtocol()


def test_the_default_is_the_papers_protocol() -> None:
    assert (PAPER.grades, PAPER.tiers, PAPER.speed) == ((0.0, 10.0, 20.0, 30.0), (0.3, 0.6, 0.9), 0.5)
    course = PAPER.find_course()
    assert PAPER.success_place == pytest.approx(0.9 * course.length)
    assert PAPER.timeout_s == pytest.approx(2.0 * course.length / PAPER.speed)
    assert PAPER.num_trials == 1536


def test_a_sweep_takes_every_degree_at_the_middle_friction_under_the_same_rules() -> None:
    sweep = sweep_protocol()
    assert sweep.grades == tuple(range(10, 41))
    assert sweep.tiers == (0.6,)
    assert sweep.departures(PAPER) == ""


def test_what_departs_from_the_protocol_is_named() -> None:
    other = dataclasses.replace(PAPER, timeout_s=2.0, noise=False, trials=3, grades=(5.0,))
    assert other.departures(PAPER) == "timeout_s 2.0, noise False"


@given(y=st.floats(-2.0, 2.0), heading=st.floats(-1.5, 1.5))
def test_steering_is_the_documented_correction(y: float, heading: float) -> None:
    limit = PAPER.yaw_rate_limit
    documented = min(max(0.5 * (0.0 - heading) - 0.3 * y, -0.2), 0.2)
    target = -PAPER.lateral_gain * y  # as `CommandManager` steers
    error = math.remainder(target - heading, 2.0 * math.pi)
    steered = float(torch.tensor(PAPER.heading_gain * error).clamp(-limit, limit))
    assert steered == pytest.approx(documented, abs=1e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"grades": ()}, "grades is \\(\\); it must have at least one"),
        ({"grades": (10.0, 10.0)}, "give each once"),
        ({"grades": (-5.0,)}, "of each, it must be 0 or more \\(too low\\)"),
        ({"tiers": (math.nan,)}, "of each, it must be 0 or more \\(not finite\\)"),
        ({"trials": 0}, "trials is 0"),
        ({"speed": 0.0}, "speed is 0"),
        ({"timeout_s": math.inf}, "timeout_s is inf"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_an_impossible_protocol_is_refused_in_one_sentence(change: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said):
        HeldOutProtocol(**change)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"course": "held-out-trak"}, "did you mean 'held-out-track'"),
        ({"grades": (45.0,)}, "grade 45 must be between 0 and 40"),
        ({"success_place": 36.0}, "success_place is 36 m; 'held-out-track' is 35 m long"),
    ],
)
def test_a_protocol_that_does_not_fit_its_course_is_refused(change: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said):
        HeldOutProtocol(**change).find_course()
