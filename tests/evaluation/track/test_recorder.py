"""Trials are recorded by trial, whatever world walks them, and their sums are those of the walk."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from humoslope.errors import UserError
from humoslope.evaluation.track.arrays import to_arrays
from humoslope.evaluation.track.metrics import BIN, METRICS_VERSION, SETTLE_S
from humoslope.evaluation.track.recorder import LegJoints, StepSample, TrackTrials
from robots.unitree_g1 import UNITREE_G1
from tests.evaluation.scripted import DT, SEGMENTS, TRACK, join, recorder, sample, walk
from tests.test_env_host_sync import NoHostSync

SETTLED = round(SETTLE_S / DT)  # control steps


def same(a: TrackTrials, b: TrackTrials) -> None:
    for (name, value), other in zip(to_arrays(a).items(), to_arrays(b).values(), strict=True):
        np.testing.assert_allclose(value, other, rtol=1e-12, atol=1e-12, err_msg=name)


# What one step shows


@given(heading=st.floats(-180, 180), pitch=st.floats(-80, 80), roll=st.floats(-40, 40))
def test_lean_of_the_torso_is_taken_in_the_heading_direction(make_env, heading, pitch, roll):
    lean = Rotation.from_euler("ZYX", [heading, pitch, roll], degrees=True)
    sample = read(make_env, torso_quat_w=quat(lean), heading_w=torch.tensor([math.radians(heading)]))
    up = Rotation.from_euler("z", -heading, degrees=True).apply(lean.apply([0.0, 0.0, 1.0]))
    assert sample.torso_pitch.item() == pytest.approx(math.atan2(up[0], up[2]), abs=1e-5)
    if abs(roll) < 1e-3:
        assert math.degrees(sample.torso_pitch.item()) == pytest.approx(pitch, abs=1e-2)


@given(pitch=st.floats(-40, 40), rate=st.floats(-1, 1))
def test_yaw_rate_is_about_the_vertical(make_env, pitch, rate):
    lean = Rotation.from_euler("y", pitch, degrees=True).inv()
    gravity, spin = (torch.tensor(lean.apply(v), dtype=torch.float32)[None] for v in ([0, 0, -1.0], [0, 0, rate]))
    assert read(make_env, projected_gravity_b=gravity, root_ang_vel_b=spin).yaw_rate.item() == pytest.approx(
        rate, abs=1e-5
    )


def quat(rotation: Rotation) -> torch.Tensor:
    return torch.tensor(rotation.as_quat(scalar_first=True), dtype=torch.float32)[None]


def read(make_env, **signals: torch.Tensor) -> StepSample:
    """The sample of a robot with these signals."""
    default = dict.fromkeys(
        ("root_pos_w", "root_ang_vel_b", "projected_gravity_b", "root_lin_vel_t"), torch.zeros(1, 3)
    )
    default |= dict.fromkeys(("heading_w", "root_height", "com_height"), torch.zeros(1))
    default |= {"torso_quat_w": quat(Rotation.identity())}
    default |= {"self_force": torch.zeros(1)}
    default |= dict.fromkeys(("joint_pos", "joint_vel", "joint_torque"), torch.zeros(1, 29))
    commands = SimpleNamespace(velocity=torch.zeros(1, 3))
    env = make_env(1, signals=SimpleNamespace(**default | signals), commands=commands)
    legs = LegJoints(UNITREE_G1, torch.device("cpu"))
    return StepSample.read(env, legs, torch.zeros(1), torch.zeros(1, dtype=torch.int64))


# Sums of a walk


def test_a_steady_walk_has_its_way_speed_and_heights() -> None:
    trials = walk(201, lambda step: {"com_height": 0.68, "root_height": 0.75})
    assert len(trials) == 1
    assert trials.samples == pytest.approx([201 - SETTLED])
    assert trials.distance == pytest.approx([200 * 0.5 * DT], rel=1e-5)
    assert trials.values["speed"] == pytest.approx([0.5])
    assert trials.values["squared_error"] == pytest.approx([0.0])
    assert trials.values["com_height"] == pytest.approx([0.68])
    assert trials.values["root_height"] == pytest.approx([0.75])


def test_speed_is_an_error_at_each_instant() -> None:
    trials = walk(SETTLED + 100, lambda step: {}, speed=0.3)
    assert trials.values["squared_error"] == pytest.approx([100 * 0.2**2], rel=1e-5)


def test_averages_over_time_begin_when_the_robot_has_settled_and_peaks_at_once() -> None:
    def show(step: int) -> dict[str, object]:
        early = step < SETTLED
        return {
            "com_height": 9.0 if early else 0.6,
            "yaw_rate": 5.0 * (-1) ** step if early else 0.1,
            "torso_pitch": 9.0 if early else 0.2,
            "left_knee_joint_torque": 120.0 if step == 3 else 50.0,
        }

    trials = walk(SETTLED + 10, show)
    assert trials.values["com_height"] == pytest.approx([0.6])
    assert trials.values["yaw_rate_variance"] == pytest.approx([0.0], abs=1e-9)
    assert trials.segment_pitch.sum() == pytest.approx(10 * 0.2)
    assert trials.values["knee_peak"] == pytest.approx([120.0])


def test_the_variance_of_a_swaying_yaw_rate_is_half_its_squared_amplitude_whatever_its_mean() -> None:
    period = 50
    trials = walk(SETTLED + 20 * period, lambda step: {"yaw_rate": 0.4 + 0.3 * math.sin(2.0 * math.pi * step / period)})
    assert trials.values["yaw_rate_variance"] == pytest.approx([0.045], rel=1e-4)


def test_work_is_power_over_the_time_between_the_first_and_the_last_sample() -> None:
    # 60 W driven by the hip, 20 W taken up by the elbow.
    joints = {
        "left_hip_pitch_joint_torque": 30.0,
        "left_hip_pitch_joint_vel": 2.0,
        "left_elbow_joint_torque": -10.0,
        "left_elbow_joint_vel": 2.0,
    }
    trials = walk(501, lambda step: joints)
    assert trials.values["work"] == pytest.approx([80.0 * 10.0])
    assert trials.values["positive_work"] == pytest.approx([60.0 * 10.0])


def test_the_peak_is_that_of_the_stronger_knee_either_way_round() -> None:
    trials = walk(
        100,
        lambda step: {
            "left_knee_joint_torque": 40.0,
            "right_knee_joint_torque": -97.5 if step == 60 else 10.0,
            "left_hip_pitch_joint_torque": 130.0,
        },
    )
    assert trials.values["knee_peak"] == pytest.approx([97.5])
    assert trials.knee_histogram.sum() == 200
    assert {k: n for k, n in enumerate(trials.knee_histogram[0]) if n} == {40: 100, 10: 99, 97: 1}


def test_each_segment_has_its_own_posture_and_load() -> None:
    def show(step: int) -> dict[str, object]:
        there = np.searchsorted(SEGMENTS, 0.5 + 0.5 * DT * step, side="right")
        return {
            "torso_pitch": 0.1 * there,
            "left_knee_joint_pos": 0.2 * there,
            "right_knee_joint_pos": 0.4 * there,
            "left_ankle_pitch_joint_torque": -8.0 * there,
            "left_ankle_pitch_joint_vel": 1.0,
        }

    trials = walk(round(9.5 / 0.01), show)
    time = trials.segment_samples[0]
    assert time == pytest.approx([150 - SETTLED, 300, 300, 200], abs=1.0)
    number = np.arange(4)
    assert trials.segment_pitch[0] / time == pytest.approx(0.1 * number, abs=1e-6)
    assert trials.segment_flexion[0] / time == pytest.approx(0.3 * number, abs=1e-6)
    assert trials.segment_torque[0] / time[:, None] == pytest.approx(np.outer(number, [0.0, 0.0, 4.0]))
    assert trials.segment_negative[0] == pytest.approx(np.outer(time * number, [0.0, 0.0, 8.0 * DT]))
    assert trials.segment_positive.sum() == 0.0


def test_values_along_the_track_lie_in_the_bins_they_were_shown_in() -> None:
    def show(step: int) -> dict[str, object]:
        place = 0.5 + 0.5 * DT * step
        return {
            "com_height": place,
            "torso_pitch": -place,
            "right_hip_pitch_joint_torque": 10.0 * place,
            "left_knee_joint_pos": 2.0 * place,
        }

    trials = walk(round(9.4 / 0.01), show)
    middle = BIN * (np.arange(round(TRACK / BIN)) + 0.5)
    there = trials.profile_samples[0] == 50
    assert there.sum() >= 16
    means = trials.profile[0] / np.maximum(trials.profile_samples[0], 1.0)[:, None]
    expected = middle[:, None] * np.array([5.0, 1.0, 1.0, -1.0])
    assert means[there] == pytest.approx(expected[there], abs=0.06)


def test_places_before_and_beyond_the_track_fall_into_its_first_and_last_bin() -> None:
    track = recorder(2)
    for _ in range(SETTLED + 1):
        track.add(torch.arange(2), sample(2, torch.tensor([-3.0, 99.0])), torch.ones(2, dtype=torch.bool))
    counted = track.trials().profile_samples
    assert counted[0, 0] == 1
    assert counted[1, -1] == 1
    assert counted.sum() == 2


# Worlds are refilled


def test_a_world_that_takes_up_another_trial_leaves_the_first_as_it_was() -> None:
    track, both = recorder(3), torch.ones(2, dtype=torch.bool)
    for step in range(SETTLED + 20):
        first = step < SETTLED + 10
        place = torch.tensor([0.5 + 0.01 * step, 0.5 + 0.01 * step if first else 0.5])
        shown = sample(2, place, com_height=torch.tensor([0.7, 0.5 if first else 0.9]))
        track.add(torch.tensor([0, 1]) if first else torch.tensor([0, 2]), shown, both)
    trials = track.trials()
    assert trials.values["com_height"][:2] == pytest.approx([0.7, 0.5])
    assert np.isnan(trials.values["com_height"][2])  # ten steps are too short
    assert trials.distance == pytest.approx([0.01 * (SETTLED + 19), 0.01 * (SETTLED + 9), 0.0], abs=1e-5)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), worlds=st.integers(1, 5))
def test_it_does_not_matter_which_world_walks_a_trial_nor_when(seed: int, worlds: int) -> None:
    rng = np.random.default_rng(seed)
    lengths = rng.integers(0, 12, size=6)  # four steps are settling
    shown = [
        [
            {
                "place": float(rng.uniform(0, TRACK)),
                "yaw_rate": float(rng.normal()),
                "left_knee_joint_torque": float(rng.normal(scale=50.0)),
                "left_knee_joint_vel": float(rng.normal()),
            }
            for _ in range(length)
        ]
        for length in lengths
    ]

    def record(worlds: int, order: np.ndarray) -> TrackTrials:
        track, waiting = recorder(6, dt=0.25), [t for t in order if lengths[t]]
        carried, step = [-1] * worlds, [0] * worlds
        while True:
            for w in range(worlds):
                if carried[w] < 0 or step[w] >= lengths[carried[w]]:
                    carried[w], step[w] = (waiting.pop(0), 0) if waiting else (-1, 0)
            if max(carried) < 0:
                return track.trials()
            values = [
                shown[t][s] if t >= 0 else dict.fromkeys(shown_names, math.nan)
                for t, s in zip(carried, step, strict=True)
            ]
            together = {name: torch.tensor([v[name] for v in values]) for name in shown_names}
            trial = torch.tensor([max(t, 0) for t in carried])  # a world without a trial still names one
            track.add(trial, sample(worlds, **together), torch.tensor([t >= 0 for t in carried]))
            step = [s + 1 for s in step]

    shown_names = ("place", "yaw_rate", "left_knee_joint_torque", "left_knee_joint_vel")
    same(record(worlds, rng.permutation(6)), record(1, np.arange(6)))


def test_a_trial_that_never_began_and_one_that_ended_at_once_leave_nothing_to_average() -> None:
    track = recorder(2)
    track.add(torch.tensor([1]), sample(1, 0.5, left_knee_joint_torque=3.0), torch.tensor([True]))
    trials = track.trials()
    assert np.isnan(trials.distance[0])
    assert trials.distance[1] == 0.0
    assert np.isnan(trials.values["speed"]).all()
    assert np.isnan(trials.values["yaw_rate_variance"]).all()
    assert trials.values["knee_peak"] == pytest.approx([np.nan, 3.0], nan_ok=True)


def test_recording_never_waits_for_the_device() -> None:
    track, worlds = recorder(4), torch.tensor([0, 2, 3])
    shown, running = sample(3, torch.tensor([0.5, 4.0, 9.0]), speed=0.4), torch.tensor([True, False, True])
    with NoHostSync():
        for _ in range(3):
            track.add(worlds, shown, running)
    assert (track.trials().distance == 0.0).tolist() == [True, False, False, True]


def test_trials_are_selected_by_slices_masks_and_indices() -> None:
    trials = walk(SETTLED + 5, lambda step: {"com_height": torch.tensor([0.6, 0.7, 0.8])}, worlds=3)
    assert trials[1:].values["com_height"] == pytest.approx([0.7, 0.8])
    assert trials[np.array([True, False, True])].values["com_height"] == pytest.approx([0.6, 0.8])
    assert trials[np.array([2, 0])].values["com_height"] == pytest.approx([0.8, 0.6])
    same(join([trials[:1], trials[1:]]), trials)


def test_a_robot_without_the_joints_of_a_group_is_a_mistake() -> None:
    kneeless = dataclasses.replace(
        UNITREE_G1, joint_names=tuple(n.replace("knee", "elbow") for n in UNITREE_G1.joint_names)
    )
    with pytest.raises(UserError, match=r"joint pattern '\.\*knee\.\*' matches nothing"):
        LegJoints(kneeless, torch.device("cpu"))


PINNED = {
    1: {
        "samples": 150.0,
        "distance": 1.194,
        "work": 132.3565,
        "positive_work": 90.3675,
        "speed": 0.3,
        "squared_error": 6.0,
        "yaw_rate_variance": 0.040625,
        "com_height": 0.66,
        "root_height": 0.74,
        "knee_peak": 41.0,
        "self_contact": 50.0,
    }
}
"""Record of the walk below under each version of the definitions."""


def test_another_meaning_of_a_recorded_metric_needs_another_version() -> None:
    """If this fails, either the change is a mistake, or METRICS_VERSION must be raised and its record added here."""

    def show(step: int) -> dict[str, object]:
        return {
            "yaw_rate": 0.2 * (-1) ** step + 0.05 * (step % 4 < 2),
            "com_height": 0.66,
            "root_height": 0.74,
            "left_knee_joint_torque": -20.0,
            "left_knee_joint_vel": 0.5275,
            "right_knee_joint_torque": 41.0 if step == 7 else 22.613,
            "right_knee_joint_vel": 1.0,
            "self_force": 2.0 * (step % 2),
        }

    trials = walk(200, show, speed=0.3)
    found = {"samples": trials.samples[0], "distance": trials.distance[0]}
    found |= {name: float(value[0]) for name, value in trials.values.items()}
    assert found == pytest.approx(PINNED[METRICS_VERSION], rel=1e-3, abs=1e-6)
