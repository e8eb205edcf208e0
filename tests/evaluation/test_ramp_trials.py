"""A trial counts until it ends, and its averages count from when the robot has settled."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from humoslope.deploy.player import TouchdownCounter
from humoslope.evaluation.ramp_trials import Recorder, Trials

DT = 0.02
NEVER = 10_000


def play(
    speed: Tensor,
    falls: list[int] | None = None,
    leaves: list[int] | None = None,
    settle: int = 0,
    across: Tensor | None = None,
    contact: Tensor | None = None,
    turn: Tensor | None = None,
    self_contact: Tensor | None = None,
) -> Trials:
    """Envs that start at x = 0.75 m and move with `speed` [T, N] m/s forward and `across` [T, N] m/s to the left; they
    fall or leave in the given steps. `contact` [T, 2] of the feet; by default both stand.
    `self_contact` [T, N]; none by default."""
    count = speed.shape[1]
    fall_step = torch.tensor(falls or [NEVER] * count)
    leave_step = torch.tensor(leaves or [NEVER] * count)
    velocity = torch.stack([speed, torch.zeros_like(speed) if across is None else across], dim=2)  # [T, N, 2]
    feet = torch.ones(len(speed), 2, dtype=torch.bool) if contact is None else contact
    touching = torch.zeros_like(speed, dtype=torch.bool) if self_contact is None else self_contact
    place = torch.tensor([[0.75, 0.0]]).repeat(count, 1)
    recorder = Recorder(place, 0.5, settle, DT)
    height = torch.full((count,), 0.75)
    for step, now in enumerate(velocity, start=1):
        place = place + now * DT
        rate = torch.zeros(count) if turn is None else turn[step - 1]
        soles, failed, left = feet[step - 1].expand(count, 2), fall_step == step, leave_step == step
        recorder.add(place, now, rate, height, soles, touching[step - 1], failed, left)
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
    undisturbed, other = play(speed, falls=[end]), play(disturbed, falls=[end])
    for name, value in vars(undisturbed).items():
        np.testing.assert_array_equal(value, getattr(other, name))


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


# A robot that is commanded to stand


def test_creep_is_the_mean_speed_either_way_and_drift_the_way_that_is_left_of_it() -> None:
    sway = 0.1 * torch.tensor([1.0, -1.0]).repeat(50)[:, None]
    trials = play(sway, across=torch.full((100, 1), -0.02))
    assert trials.creep[0] == pytest.approx([0.1, 0.02])
    assert trials.drift[0] == pytest.approx([0.0, -0.04], abs=1e-6)
    assert trials.speed == pytest.approx([0.0], abs=1e-8)


def test_creep_and_drift_begin_when_the_robot_has_settled() -> None:
    speed = torch.cat([torch.full((40, 1), 0.5), torch.full((60, 1), 0.1)])
    trials = play(speed, settle=40, across=torch.zeros_like(speed))
    assert trials.creep[0] == pytest.approx([0.1, 0.0])
    assert trials.drift[0] == pytest.approx([0.12, 0.0], rel=1e-4)


def test_a_robot_that_fell_before_it_settled_has_neither_creep_nor_drift_nor_steps() -> None:
    trials = play(torch.full((50, 1), 0.5), falls=[10], settle=20)
    assert np.isnan([*trials.creep[0], *trials.drift[0], *trials.touchdowns]).all()


@given(air=st.integers(1, 20), landings=st.integers(0, 4), settle=st.integers(0, 1))
def test_a_step_is_a_landing_after_the_time_in_the_air_that_makes_a_swing_of_an_export_too(
    air: int, landings: int, settle: int
) -> None:
    stand, lift = [[True, True]] * 2, [[True, False]] * air
    feet = [*stand, *(lift + stand) * landings, *lift]  # ends in the air
    trials = play(torch.zeros(len(feet), 1), contact=torch.tensor(feet), settle=settle)
    steps = landings if air * DT >= 0.06 - 1e-9 else 0
    counter = TouchdownCounter(2, DT)
    for down in feet[settle:]:
        counter.add(np.array(down))
    assert counter.count == steps
    assert trials.touchdowns == pytest.approx([steps / ((len(feet) - settle) * DT)])


def test_landings_before_settling_do_not_count() -> None:
    feet = torch.ones(100, 2, dtype=torch.bool)
    feet[10:20, 0] = feet[60:70, 1] = False
    trials = play(torch.zeros(100, 1), contact=feet, settle=50)
    assert trials.touchdowns == pytest.approx([1.0])


# A robot that walks to a side or turns


def test_speed_to_the_left_and_yaw_rate_are_means_with_a_sign_from_settling_to_the_end() -> None:
    across = torch.cat([torch.full((40, 2), 9.0), torch.tensor([[0.2, -0.4]]).repeat(60, 1)])
    turn = torch.cat([torch.full((40, 2), -9.0), torch.tensor([[0.6, -0.3]]).repeat(60, 1)])
    trials = play(torch.zeros(100, 2), across=across, turn=turn, settle=40, falls=[NEVER, 90])
    assert trials.lateral == pytest.approx([0.2, -0.4])
    assert trials.yaw_rate == pytest.approx([0.6, -0.3])
    assert trials.measured_s == pytest.approx([60 * DT, 49 * DT])


def test_self_contact_is_a_share_of_the_time_between_settling_and_the_end_of_a_trial() -> None:
    touching = torch.zeros(100, 2, dtype=torch.bool)
    touching[:60] = True
    touching[80:, 1] = True
    trials = play(torch.full((100, 2), 0.5), falls=[NEVER, 91], settle=50, self_contact=touching)
    assert trials.self_contact == pytest.approx([10 / 50, 20 / 40])
    assert np.isnan(play(torch.full((50, 1), 0.5), falls=[10], settle=20).self_contact).all()
