"""The figures of a table, on walks whose figures are known beforehand."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.evaluation.track.metrics import BIN, SETTLE_S, cost_of_transport, knee_quantile
from humoslope.evaluation.track.recorder import TrackTrials
from humoslope.evaluation.track.summary import SlopeLimit, Summary, diagnose, profile, slope_limit, summarise
from tests.evaluation.scripted import DT, as_if, join, outcomes, walk

SETTLED = round(SETTLE_S / DT)
MASS = 30.0
HIP, KNEE, ANKLE = "left_hip_pitch_joint", "left_knee_joint", "left_ankle_pitch_joint"


def figures(trials: TrackTrials, **ended: object) -> Summary:
    return summarise(outcomes(trials, **ended), np.ones(len(trials), dtype=bool), MASS, 0.5)


def steady(count: int, **values: object) -> TrackTrials:
    """`count` trials of four seconds at 0.5 m/s."""
    return walk(201, lambda step: values, worlds=count)


def test_success_rate_distance_and_time_are_those_of_the_trials_that_count() -> None:
    told = figures(
        steady(4),
        success=[True, False, True, False],
        fell=[False, True, False, False],
        timed_out=[False, False, False, True],
        seconds=[60.0, 7.0, 64.0, 140.0],
        max_place=[31.5, 3.5, 31.5, 12.0],
    )
    assert (told["success"].count, told["success"].total) == (2, 4)
    # Wilson's interval for 2 of 4, from its closed form.
    z = 1.959964
    half = z * math.sqrt(0.25 / 4 + z**2 / 64) / (1 + z**2 / 4)
    assert (told["success"].low, told["success"].high) == pytest.approx((0.5 - half, 0.5 + half), abs=1e-4)
    assert (told["fell"], told["left"], told["timed_out"]) == (1, 0, 1)
    assert told["max_distance"].mean == pytest.approx((31.5 + 3.5 + 31.5 + 12.0) / 4)
    assert (told["traversal_s"].mean, told["traversal_s"].trials) == (pytest.approx(62.0), 2)


def test_without_a_success_there_is_no_traversal_time() -> None:
    told = figures(steady(2), seconds=[1.0, 2.0])
    assert told["traversal_s"] is None
    assert told["cost_of_transport_successes"] is None
    assert told["success"].share == 0.0


def test_only_the_chosen_trials_count() -> None:
    trials = steady(3, com_height=torch.tensor([0.6, 0.7, 0.8]))
    told = summarise(outcomes(trials, success=[True, False, True]), np.array([True, False, True]), MASS, 0.5)
    assert told["com_height"].mean == pytest.approx(0.7)
    assert told["com_height"].std == pytest.approx(0.1 * math.sqrt(2.0))
    assert told["success"].total == 2
    with pytest.raises(UserError, match="at least one"):
        summarise(outcomes(trials), np.zeros(3, dtype=bool), MASS, 0.5)


def test_too_fast_and_too_slow_trials_do_not_make_up_for_each_other() -> None:
    trials = join([walk(201, lambda step: {}, speed=speed) for speed in (0.3, 0.7)])
    told = figures(trials)
    assert told["speed"].mean == pytest.approx(0.5)
    assert told["speed_error"].mean == pytest.approx(0.2)
    assert told["speed_rms_error"] == pytest.approx(0.2)


def test_cost_of_transport_is_power_over_weight_and_speed() -> None:
    # 75 W driven and 25 W taken up, at 0.5 m/s.
    joints = {f"{HIP}_torque": 50.0, f"{HIP}_vel": 1.5, f"{KNEE}_torque": -25.0, f"{KNEE}_vel": 1.0}
    told = figures(steady(2, **joints), success=[True, False])
    assert told["cost_of_transport"] == pytest.approx(100.0 / (MASS * 9.81 * 0.5), rel=1e-5)
    assert told["cost_of_transport_positive"] == pytest.approx(75.0 / (MASS * 9.81 * 0.5), rel=1e-5)
    assert told["cost_of_transport_successes"] == pytest.approx(told["cost_of_transport"])


def test_a_trial_weighs_in_the_cost_of_transport_by_its_way() -> None:
    near = as_if(steady(2), work=[300.0, 900.0], distance=[1.0, 9.0])
    assert cost_of_transport(near, MASS) == pytest.approx(1200.0 / (MASS * 9.81 * 10.0))


def test_standing_has_no_cost_of_transport() -> None:
    joints = {f"{HIP}_torque": 50.0, f"{HIP}_vel": 1.5}
    assert cost_of_transport(walk(201, lambda step: joints, speed=0.001), MASS) is None
    never = as_if(steady(2), distance=[math.nan, math.nan])
    assert cost_of_transport(never, MASS) is None
    assert cost_of_transport(as_if(steady(2), distance=[math.nan, 2.0]), MASS) == 0.0


def test_the_peak_is_the_mean_of_the_peaks_and_the_largest_is_told_too() -> None:
    told = figures(steady(2, left_knee_joint_torque=torch.tensor([80.0, -120.0])))
    assert told["knee_peak"].mean == pytest.approx(100.0)
    assert told["knee_max"] == pytest.approx(120.0)


def test_ninety_nine_of_a_hundred_instants_stay_below_the_quantile() -> None:
    rng = np.random.default_rng(0)
    torque = np.minimum(np.abs(rng.normal(scale=40.0, size=(1000, 2))), 139.0)
    trials = walk(
        1000,
        lambda step: {"left_knee_joint_torque": torque[step, 0], "right_knee_joint_torque": -torque[step, 1]},
        speed=0.0,
    )
    for share in (0.5, 0.99):
        expected = np.quantile(torque, share, method="inverted_cdf")
        assert knee_quantile(trials, share) == pytest.approx(expected, abs=0.5)
    assert knee_quantile(trials[:0], 0.99) is None


@pytest.fixture(scope="module")
def trials() -> TrackTrials:
    return steady(1)


@given(torque=st.floats(0.0, 138.0), share=st.floats(0.01, 0.99))
def test_the_quantile_of_a_constant_torque_is_the_middle_of_its_bin(
    trials: TrackTrials, torque: float, share: float
) -> None:
    histogram = np.zeros_like(trials.knee_histogram)
    histogram[0, math.floor(torque)] = 402
    assert knee_quantile(as_if(trials, knee_histogram=histogram), share) == math.floor(torque) + 0.5


def test_nothing_was_measured_of_trials_that_ended_before_they_settled() -> None:
    told = figures(walk(SETTLED - 1, lambda step: {"com_height": 0.7}))
    nothing = (
        told["speed"],
        told["speed_error"],
        told["speed_rms_error"],
        told["yaw_rate_variance"],
        told["com_height"],
    )
    assert set(nothing) == {None}
    assert told["root_height"] is None


def test_a_trial_that_ended_early_does_not_lower_the_averages_of_the_others() -> None:
    trials = join([walk(SETTLED - 1, lambda step: {}), steady(1, com_height=0.7)])
    told = figures(trials)["com_height"]
    assert (told.mean, told.trials) == (pytest.approx(0.7), 1)


# Diagnostics


def test_posture_and_load_are_told_by_direction_and_shares_sum_to_one() -> None:
    def show(step: int) -> dict[str, object]:
        uphill = 2.0 <= 0.5 + 0.01 * step < 5.0
        return {
            "torso_pitch": 0.2 if uphill else -0.1,
            f"{KNEE}_pos": 0.4,
            "right_knee_joint_pos": 0.8,
            f"{HIP}_torque": -30.0 if uphill else -2.0,
            f"{HIP}_vel": -2.0,
            f"{KNEE}_torque": 10.0,
            f"{KNEE}_vel": 2.0 if uphill else -2.0,
            "left_shoulder_pitch_joint_torque": 9.0,
            "left_shoulder_pitch_joint_vel": 9.0,
        }

    told = diagnose(walk(700, show), directions=[0, 1, 0, -1])
    up, flat = told["up"], told["flat"]
    assert told["down"] is None
    assert up is not None
    assert flat is not None
    assert up.torso_pitch == pytest.approx(0.2)
    assert up.knee_flexion == pytest.approx(0.6)
    assert up.torque == pytest.approx({"hip": 15.0, "knee": 5.0, "ankle": 0.0})
    assert up.positive_share == pytest.approx({"hip": 0.75, "knee": 0.25, "ankle": 0.0})
    assert up.negative_share is None
    assert flat.torso_pitch == pytest.approx(-0.1)
    assert flat.positive_share == pytest.approx({"hip": 1.0, "knee": 0.0, "ankle": 0.0})
    assert flat.negative_share == pytest.approx({"hip": 0.0, "knee": 1.0, "ankle": 0.0})


def test_along_the_track_there_are_values_where_somebody_was() -> None:
    along = profile(walk(300, lambda step: {"com_height": 0.5 + 0.01 * step, "torso_pitch": 0.1}))
    heights = along["com_height"]
    assert heights[0] is None  # the walk settled beyond it
    assert heights[round(4.0 / BIN) :] == [None] * round(6.0 / BIN)
    there = [value for value in heights if value is not None]
    assert len(there) == 5
    assert all(low < high for low, high in itertools.pairwise(there))
    assert [value for value in along["torso_pitch"] if value is not None] == pytest.approx([0.1] * 5)


# The slope limit


@pytest.mark.parametrize(
    ("successes", "expected"),
    [
        ((4, 4, 2, 1), SlopeLimit(12.0, 13.0, False)),
        ((4, 1, 4, 0), SlopeLimit(10.0, 12.0, False)),  # a steeper grade that happens to go well does not count
        ((1, 4, 4, 4), SlopeLimit(None, 13.0, False)),
        ((0, 0, 0, 0), SlopeLimit(None, None, False)),
        ((4, 4, 4, 2), SlopeLimit(13.0, 13.0, True)),
    ],
)
def test_the_climb_stops_at_the_first_grade_that_is_not_mastered(
    successes: tuple[int, ...], expected: SlopeLimit
) -> None:
    grades = (10.0, 11.0, 12.0, 13.0)
    assert slope_limit(grades, successes, (4,) * 4) == expected
    assert slope_limit(grades[::-1], successes[::-1], (4,) * 4) == expected
