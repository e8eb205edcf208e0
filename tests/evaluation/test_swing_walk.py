"""Which instants of walking count as swing."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from humoslope.errors import UserError
from humoslope.evaluation.ramps import APPROACH
from humoslope.evaluation.swing_walk import CLEAR, SwingProtocol, SwingRecorder, SwingSamples, hip_joints
from robots.unitree_g1 import UNITREE_G1

DT = 0.02
STEPS = 100
ON_RAMP = APPROACH + CLEAR
FULL, NONE = 300.0, 0.0


def play(
    speed: float = 0.5, place: float = ON_RAMP, force: Tensor | None = None, fall: int = STEPS + 1, **changes: Any
) -> SwingSamples:
    """One world on a slope of 0.1 rad for 100 steps; the left hip holds the number of the step, the right one less than
    zero. `force` [T, 2]; by default the left foot is in the air throughout."""
    protocol = dataclasses.replace(SwingProtocol(), **changes)
    recorder = SwingRecorder(protocol, 1, DT, torch.device("cpu"))
    force = torch.tensor([NONE, FULL]).expand(STEPS, 2) if force is None else force
    for step in range(STEPS):
        recorder.add(
            place=torch.tensor([place]),
            speed=torch.tensor([speed]),
            slope=torch.tensor([0.1]),
            flexion=torch.tensor([[float(step), -1.0 - step]]),
            force=force[step][None],
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
    force, no = torch.tensor([[NONE, FULL]]), torch.tensor([False])
    for step in range(steps):
        surging = torch.tensor([0.5 + 0.3 * math.sin(2.0 * math.pi * step * DT / 0.4)])
        recorder.add(place, surging, slope, torch.full((1, 2), float(step)), force, no, no)
    counted = recorder.samples().flexion
    assert counted.tolist() == list(range(int(counted[0]), steps))


def test_the_approach_does_not_count() -> None:
    assert len(play(place=ON_RAMP - 0.01)) == 0
    assert len(play(place=ON_RAMP)) > 0


@settings(max_examples=15)
@given(lift=st.integers(50, 80), land=st.integers(81, 100))
def test_a_foot_counts_a_tenth_of_a_second_after_lift_off_until_it_lands(lift: int, land: int) -> None:
    force = torch.full((STEPS, 2), FULL)
    force[lift:land, 1] = 4.9
    found = play(force=force)
    assert (-1.0 - found.flexion).tolist() == list(range(lift + 5, land))


def test_a_bounce_starts_the_swing_anew() -> None:
    force = torch.full((STEPS, 2), FULL)
    force[60:80, 0] = NONE
    force[70, 0] = 5.0
    assert play(force=force).flexion.tolist() == [65, 66, 67, 68, 69, 76, 77, 78, 79]


@settings(max_examples=15)
@given(fall=st.integers(1, STEPS))
def test_what_a_world_does_from_its_fall_on_does_not_count(fall: int) -> None:
    whole = play().flexion
    assert play(fall=fall).flexion.tolist() == whole[whole < fall - 1].tolist()


def test_worlds_and_feet_are_told_apart() -> None:
    recorder = SwingRecorder(SwingProtocol(swing_time=0.0, speed_tolerance=1.0), 3, DT, torch.device("cpu"))
    no = torch.zeros(3, dtype=torch.bool)
    force = torch.tensor([[NONE, FULL], [FULL, FULL], [FULL, NONE]])
    flexion = torch.tensor([[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]])
    recorder.add(torch.full((3,), 5.0), torch.full((3,), 0.5), torch.tensor([0.0, 0.1, 0.2]), flexion, force, no, no)
    found = recorder.samples()
    assert found.world.tolist() == [0, 2]
    assert found.slope == pytest.approx([0.0, 0.2])
    assert found.flexion == pytest.approx([0.1, 0.6])


def test_nothing_walked_is_nothing_gathered() -> None:
    found = SwingRecorder(SwingProtocol(), 3, DT, torch.device("cpu")).samples()
    assert len(found) == 0
    assert found.flexion.dtype == np.float64


def test_the_default_pattern_finds_the_hips_left_first() -> None:
    left, right = hip_joints(UNITREE_G1, SwingProtocol().hip_joints)
    assert UNITREE_G1.joint_names[left] == "left_hip_pitch_joint"
    assert UNITREE_G1.joint_names[right] == "right_hip_pitch_joint"


def test_hips_are_found_left_first_whatever_the_order_of_joints() -> None:
    robot: Any = SimpleNamespace(name="robot", joint_names=("waist", "right_hip", "left_hip"))
    assert hip_joints(robot, ".*hip") == [2, 1]


@pytest.mark.parametrize(
    ("pattern", "said"),
    [
        (".*hip_pich.*", "matches nothing of"),
        (".*hip.*", "matches left_hip_pitch_joint, left_hip_roll_joint"),
        ("left_hip_(pitch|roll).*", "one with 'right' in its name"),
        ("left_hip_pitch.*", "matches left_hip_pitch_joint of"),
        ("hip(", "is no regular expression"),
    ],
)
def test_a_pattern_that_does_not_give_one_hip_on_each_side_is_refused(pattern: str, said: str) -> None:
    with pytest.raises(UserError) as caught:
        hip_joints(UNITREE_G1, pattern)
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"unloaded": 0.0}, "unloaded is 0; it must be positive"),
        ({"speed_tolerance": math.nan}, "speed_tolerance is nan"),
        ({"swing_time": -0.1}, "swing_time is -0.1 s"),
        ({"starts": 0}, "starts is 0"),
    ],
)
def test_an_impossible_protocol_is_refused_in_one_sentence(change: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said):
        SwingProtocol(**change)
