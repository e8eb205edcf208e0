"""Which instants of walking count as swing."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from humoslope.errors import UserError
from humoslope.evaluation.ramps import APPROACH
from humoslope.evaluation.swing.samples import CLEAR, SwingProtocol, SwingRecorder, SwingSamples

DT = 0.02
STEPS = 100
ON_RAMP = APPROACH + CLEAR
LEFT = torch.tensor([True, False])
LEFT_THROUGHOUT = LEFT.expand(STEPS, 2)


def play(
    speed: float = 0.5, place: float = ON_RAMP, swinging: Tensor = LEFT_THROUGHOUT, fall: int = STEPS + 1
) -> SwingSamples:
    """One world on a slope of 0.1 rad for 100 steps; the left hip's flexion is the number of the step, the right one's
    its negative. `swinging` [T, 2]; by default the left leg swings throughout."""
    recorder = SwingRecorder(SwingProtocol(), 1, DT, torch.device("cpu"))
    for step in range(STEPS):
        recorder.add(
            place=torch.tensor([place]),
            speed=torch.tensor([speed]),
            slope=torch.tensor([0.1]),
            flexion=torch.tensor([[1.0, -1.0]]) * step,
            swinging=swinging[step][None],
            failed=torch.tensor([step + 1 == fall]),
            ended=torch.tensor([False]),
        )
    return recorder.samples()


def test_a_robot_from_rest_counts_once_its_mean_speed_is_near_the_commanded() -> None:
    first = math.ceil(math.log(0.5 / 0.2) / DT)  # when 0.5 (1 - exp(-t)) has passed 0.3 m/s
    assert play().flexion.tolist() == pytest.approx(range(first - 1, STEPS))
    assert play().slope.tolist() == pytest.approx([0.1] * len(play()))


@pytest.mark.parametrize(("speed", "counts"), [(0.2, False), (1.5, False), (0.5, True)])
def test_a_robot_at_another_speed_does_not_count(speed: float, counts: bool) -> None:
    assert (STEPS - 1 in play(speed).flexion) == counts


def test_a_surge_within_a_stride_makes_no_gap() -> None:
    recorder, steps = SwingRecorder(SwingProtocol(), 1, DT, torch.device("cpu")), 300
    place, slope = torch.tensor([ON_RAMP]), torch.zeros(1)
    no = torch.tensor([False])
    for step in range(steps):
        surging = torch.tensor([0.5 + 0.3 * math.sin(2.0 * math.pi * step * DT / 0.4)])
        recorder.add(place, surging, slope, torch.full((1, 2), float(step)), LEFT[None], no, no)
    counted = recorder.samples().flexion
    assert counted.tolist() == list(range(int(counted[0]), steps))


def test_the_approach_does_not_count() -> None:
    assert len(play(place=ON_RAMP - 0.01)) == 0
    assert len(play(place=ON_RAMP)) > 0


def test_only_the_swinging_leg_counts() -> None:
    swinging = torch.zeros(STEPS, 2, dtype=torch.bool)
    swinging[60:63, 0] = swinging[70:73, 1] = True
    assert play(swinging=swinging).flexion.tolist() == [60, 61, 62, -70, -71, -72]


@settings(max_examples=15)
@given(fall=st.integers(1, STEPS))
def test_what_a_world_does_from_its_fall_on_does_not_count(fall: int) -> None:
    whole = play().flexion
    assert play(fall=fall).flexion.tolist() == whole[whole < fall - 1].tolist()


def test_worlds_and_feet_are_told_apart() -> None:
    recorder = SwingRecorder(SwingProtocol(speed_tolerance=1.0), 3, DT, torch.device("cpu"))
    no = torch.zeros(3, dtype=torch.bool)
    swinging = torch.tensor([[True, False], [False, False], [False, True]])
    flexion = torch.tensor([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]])
    recorder.add(torch.full((3,), 5.0), torch.full((3,), 0.5), torch.tensor([0.0, 0.1, 0.2]), flexion, swinging, no, no)
    found = recorder.samples()
    assert found.slope == pytest.approx([0.0, 0.2])
    assert found.flexion == pytest.approx([0.1, 0.6])


def test_nothing_walked_is_nothing_gathered() -> None:
    found = SwingRecorder(SwingProtocol(), 3, DT, torch.device("cpu")).samples()
    assert len(found) == 0
    assert found.flexion.dtype == np.float64


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"speed": 0.0}, "speed is 0; it must be positive"),
        ({"swing_force": 0.0}, "swing_force is 0; it must be positive"),
        ({"speed_tolerance": math.nan}, "speed_tolerance is nan"),
        ({"swing_settle": -0.1}, "swing_settle is -0.1; it must be 0 or more"),
        ({"swing_settle": 0.7}, "no swing counts from 0.7 to 0.6 s after lift-off; swing_longest must be no less"),
        ({"starts": 0}, "starts is 0"),
    ],
)
def test_an_impossible_protocol_is_refused_in_one_sentence(change: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said):
        SwingProtocol(**change)
