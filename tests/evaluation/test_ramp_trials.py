"""A trial counts until it ends, and its averages count from when the robot has settled."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from humoslope.evaluation.ramp_trials import Recorder, Trials

DT = 0.02
NEVER = 10_000


def play(
    speed: Tensor,
    height: float = 0.75,
    falls: list[int] | None = None,
    leaves: list[int] | None = None,
    settle: int = 0,
) -> Trials:
    """Worlds that start at x = 0.75 m and move with `speed` [T, N] m/s; they fall or leave in the given steps."""
    count = speed.shape[1]
    fall_step = torch.tensor(falls or [NEVER] * count)
    leave_step = torch.tensor(leaves or [NEVER] * count)
    place = torch.full((count,), 0.75)
    recorder = Recorder(place, 0.5, settle, DT)
    for step, now in enumerate(speed, start=1):
        place = place + now * DT
        recorder.add(place, now, torch.full((count,), 0.75), fall_step == step, leave_step == step)
    return recorder.trials()


def test_a_steady_walker_has_its_speed_height_and_way() -> None:
    trials = play(torch.full((100, 1), 0.4))
    assert not trials.fell.any()
    assert not trials.left.any()
    assert trials.seconds == pytest.approx([2.0])
    assert trials.speed == pytest.approx([0.4])
    assert trials.height == pytest.approx([0.75])
    assert trials.end - trials.start == pytest.approx([0.8], rel=1e-5)
    assert trials.speed_error(0.5) == pytest.approx(0.1)
    assert trials.rms_speed_error == pytest.approx(0.1)


def test_surging_is_an_error_at_each_instant_but_none_on_average() -> None:
    speed = 0.5 + 0.2 * torch.tensor([1.0, -1.0]).repeat(50)[:, None]
    trials = play(speed)
    assert trials.speed_error(0.5) == pytest.approx(0.0, abs=1e-6)
    assert trials.rms_speed_error == pytest.approx(0.2)


def test_too_fast_and_too_slow_trials_do_not_make_up_for_each_other() -> None:
    trials = play(torch.tensor([0.3, 0.7]).expand(50, 2))
    assert trials.speed.mean() == pytest.approx(0.5)
    assert trials.speed_error(0.5) == pytest.approx(0.2)


def test_getting_up_to_speed_does_not_count() -> None:
    speed = torch.cat([torch.zeros(30, 1), torch.full((70, 1), 0.5)])
    assert play(speed, settle=30).speed == pytest.approx([0.5])
    assert play(speed, settle=0).speed == pytest.approx([0.35])


def test_a_fall_ends_a_trial_and_the_step_of_the_fall_is_not_walked() -> None:
    trials = play(torch.full((50, 2), 0.5), falls=[20, NEVER], leaves=[30, 40])
    assert trials.fell.tolist() == [True, False]
    assert trials.left.tolist() == [False, True]
    assert trials.samples == pytest.approx([19, 39])
    assert trials.seconds == pytest.approx([0.4, 0.8])
    assert trials.end - trials.start == pytest.approx([19 * 0.01, 39 * 0.01], rel=1e-5)


def test_a_fall_at_the_edge_is_a_fall() -> None:
    trials = play(torch.full((10, 1), 0.5), falls=[5], leaves=[5])
    assert trials.fell.all()
    assert not trials.left.any()


@given(end=st.integers(1, 30), junk=st.floats(-1e6, 1e6))
def test_what_a_world_does_after_its_end_changes_nothing(end: int, junk: float) -> None:
    speed = torch.full((30, 1), 0.5)
    disturbed = speed.clone()
    disturbed[end - 1 :] = junk
    for name, value in vars(play(speed, falls=[end])).items():
        np.testing.assert_array_equal(value, getattr(play(disturbed, falls=[end]), name))


def test_a_fall_before_settling_leaves_nothing_to_measure() -> None:
    trials = play(torch.full((50, 1), 0.5), falls=[10], settle=20)
    assert np.isnan(trials.speed).all()
    assert trials.speed_error(0.5) is None
    assert trials.rms_speed_error is None


def test_trials_can_be_taken_apart() -> None:
    trials = play(torch.tensor([0.1, 0.2, 0.3]).expand(10, 3))
    assert len(trials) == 3
    assert trials[1:].speed == pytest.approx([0.2, 0.3])


def test_a_nan_of_a_diverged_world_stays_out_of_the_averages() -> None:
    speed = torch.full((10, 2), 0.5)
    speed[5:, 0] = torch.nan
    trials = play(speed, falls=[6, NEVER])
    assert trials.speed == pytest.approx([0.5, 0.5])
    assert trials.rms_speed_error == pytest.approx(0.0)
