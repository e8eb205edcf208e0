"""Figures of a gait against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from humoslope.deploy.gait import GaitRecorder, fast_share

TIME = np.arange(900) * 0.02
"""18 s, in which all frequencies below are whole numbers of periods."""


def sine(hz: float) -> np.ndarray:
    return np.sin(2.0 * math.pi * hz * TIME)


@given(slow=st.floats(0.1, 2.0), fast=st.floats(0.1, 2.0))
def test_of_two_sines_the_fast_one_has_the_share_of_its_squared_amplitude(slow: float, fast: float) -> None:
    targets = np.stack([0.3 + slow * sine(2.0) + fast * sine(15.0), 2.0 * sine(1.0)], axis=1)
    assert fast_share(targets, 0.02) == pytest.approx(fast**2 / (slow**2 + fast**2))


def test_the_highest_frequency_counts_once_and_a_still_joint_not_at_all() -> None:
    flips = np.where(np.arange(900) % 2, -1.0, 1.0)  # 25 Hz: twice the variance of a sine of that amplitude
    assert fast_share((flips + sine(2.0))[:, None], 0.02) == pytest.approx(1.0 / 1.5)
    odd = (flips + sine(2.0))[:899, None]  # no frequency is its own negative then
    assert fast_share(odd, 0.02) == pytest.approx(1.0 / 1.5, abs=0.01)
    assert fast_share(np.stack([sine(2.0), 0.009 * flips], axis=1), 0.02) == pytest.approx(0.0, abs=1e-12)
    assert fast_share(np.full((5, 3), 0.2), 0.02) == 0.0


def test_times_and_knees_are_averaged_over_the_steps() -> None:
    recorder = GaitRecorder(["left_knee_joint", "waist", "right_knee_joint"], 0.02)
    for down, touches, knees in (((1, 1), True, 0.2), ((1, 0), False, 0.4), ((0, 0), False, 0.6), ((1, 1), False, 0.8)):
        recorder.add(np.zeros(3), np.array([knees, 9.0, knees + 0.1]), np.array(down, bool), touches)
    gait = recorder.gait()
    assert (gait.self_contact, gait.double_support) == (0.25, 0.5)
    assert gait.knee_flexion == pytest.approx(0.55)
    assert gait.fast_share == 0.0


def test_what_was_never_seen_is_not_a_number() -> None:
    empty = GaitRecorder(["left_knee_joint"], 0.02).gait()
    assert all(math.isnan(value) for value in vars(empty).values())
    armless = GaitRecorder(["wheel"], 0.02)
    armless.add(np.zeros(1), np.zeros(1), np.array([True]), False)
    assert math.isnan(armless.gait().knee_flexion)
