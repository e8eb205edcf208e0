"""The rewards of the slope gait adapter, one by one."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.slope import bsga

DEG = math.pi / 180.0
shares = st.floats(0.0, 1.0)
slopes = st.floats(-50.0 * DEG, 50.0 * DEG)
weights = st.floats(0.01, 2.0)


def scalar(value):
    return torch.tensor(value, dtype=torch.float64)


def regime(slope):
    return torch.tensor(slope > 3.0 * DEG), torch.tensor(slope < -3.0 * DEG)


FLAT, UP, DOWN = (regime(angle * DEG) for angle in (0.0, 20.0, -20.0))


# Weights


@given(
    w_com=weights,
    w_bio=weights,
    w_swing=weights,
    w_up=weights,
    w_down=weights,
    brake=weights,
    stride=weights,
    r=st.tuples(shares, shares, shares, shares, shares),
)
def test_the_weighted_terms_sum_to_the_papers_core_reward(w_com, w_bio, w_swing, w_up, w_down, brake, stride, r):
    r_com, r_hip, r_brake, r_stride, r_swing = r
    r_down = brake * r_brake + stride * r_stride
    r_bio = (w_up * r_hip + w_down * r_down) / (w_up + w_down)
    core = w_com * r_com + w_bio * r_bio + w_swing * r_swing
    resolved = bsga.branch_weights(w_com, w_bio, w_swing, w_up, w_down, brake, stride)
    assert sum(w * x for w, x in zip(resolved, r, strict=True)) == pytest.approx(core, abs=1e-8)


def test_ascent_and_descent_without_any_weight_are_refused():
    with pytest.raises(UserError, match="w_up 0 and w_down 0 must have a positive sum"):
        bsga.branch_weights(w_up=0.0, w_down=0.0)


# Gate and intensity


@pytest.mark.parametrize(
    ("speed", "asked", "expected"),
    [
        (0.0, 0.5, 0.0),
        (0.25, 0.5, 0.5),
        (0.5, 0.5, 1.0),
        (0.9, 0.5, 1.0),
        (-0.5, 0.5, 0.0),
        (0.5, 0.0, 0.0),  # nothing is asked
        (0.5, -0.5, 0.0),  # the other direction is asked
        (-0.25, -0.5, 0.5),
        (0.01, 0.02, 0.1),  # swaying does not pay where next to nothing is asked
    ],
)
@pytest.mark.parametrize("heading", [0.0, 90.0, -150.0])
def test_progress_is_the_share_of_the_commanded_speed_that_is_walked_in_its_direction(speed, asked, expected, heading):
    ahead = torch.tensor([math.cos(heading * DEG), math.sin(heading * DEG)])
    aside = torch.stack([-ahead[1], ahead[0]])
    walked = speed * ahead + 0.4 * aside  # what is walked at right angles does not count
    assert bsga.progress(walked[None], (asked * ahead)[None], least=0.1).item() == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(("degrees", "expected"), [(0.0, 0.0), (15.0, 0.5), (-15.0, 0.5), (30.0, 1.0), (-45.0, 1.0)])
def test_slope_intensity_rises_to_one_at_full_slope_uphill_and_downhill_alike(degrees, expected):
    assert bsga.slope_intensity(scalar(degrees * DEG), 30.0 * DEG).item() == pytest.approx(expected)


# Height of the centre of mass


def target(slope):
    angle = scalar(slope)
    rho = bsga.slope_intensity(angle, bsga.FULL_SLOPE)
    return bsga.com_height_target(angle, rho, *regime(slope), 0.69, bsga.OFFSET_UP, bsga.OFFSET_DOWN).item()


@given(slope=slopes)
def test_the_height_target_is_the_papers_equation(slope):
    rho = min(abs(slope) / (30.0 * DEG), 1.0)
    offset = 0.01 * (slope > 3.0 * DEG) - 0.03 * (slope < -3.0 * DEG)
    assert target(slope) == pytest.approx(0.69 * math.cos(abs(slope)) + rho * offset, abs=1e-8)


@given(slope=slopes, leg=st.floats(0.3, 0.8))
def test_the_height_over_a_slope_is_the_distance_to_its_plane(slope, leg):
    com = torch.tensor([0.0, 0.0, leg], dtype=torch.float64)
    normal = torch.tensor([-math.sin(slope), 0.0, math.cos(slope)], dtype=torch.float64)
    assert bsga.com_height_over_slope(scalar(leg), scalar(slope)).item() == pytest.approx((com @ normal).item())


@given(slope=slopes)
def test_an_upright_leg_of_nominal_length_misses_its_target_by_the_offset_alone(slope):
    rho = min(abs(slope) / (30.0 * DEG), 1.0)
    offset = rho * (0.01 * (slope > 3.0 * DEG) - 0.03 * (slope < -3.0 * DEG))
    height = bsga.com_height_over_slope(scalar(0.69), scalar(slope))
    assert height.item() - target(slope) == pytest.approx(-offset, abs=1e-8)


@given(error=st.floats(-0.3, 0.3))
def test_the_height_reward_is_a_bell_of_the_error(error):
    reward = bsga.com_height_reward(scalar(0.7 + error), scalar(0.7), std=0.1)
    assert reward.item() == pytest.approx(math.exp(-((error / 0.1) ** 2)))


# Hip


def hip(share, rho, gates):
    up, _ = gates
    return bsga.hip_reward(scalar(share), scalar(rho), up, bsga.HIP_SHARE, bsga.HIP_SHARE_RISE).item()


@given(share=shares, rho=shares)
def test_the_hip_earns_its_share_up_to_the_target_and_only_uphill(share, rho):
    assert hip(share, rho, UP) == pytest.approx(min(share / (0.33 + 0.17 * rho), 1.0))
    assert hip(share, rho, FLAT) == hip(share, rho, DOWN) == 0.0


@pytest.mark.parametrize(("part", "total", "expected"), [(30.0, 60.0, 0.5), (2.0, 2.0, 0.4), (0.0, 0.0, 0.0)])
def test_a_share_of_next_to_no_work_fades_to_nothing(part, total, expected):
    assert bsga.work_share(scalar(part), scalar(total), least=5.0).item() == pytest.approx(expected)


# Knee


def brake(knee, load, share, rho, gates):
    _, down = gates
    return bsga.brake_reward(
        scalar(knee),
        scalar(load),
        scalar(share),
        down,
        target=bsga.KNEE_FLEXION + bsga.KNEE_FLEXION_RISE * scalar(rho),
        std=bsga.KNEE_STD,
        full_share=bsga.BRAKE_SHARE,
    ).item()


@given(knee=st.floats(-0.1, 2.5), share=shares, rho=shares, force=st.floats(10.0, 1000.0))
def test_the_braking_knee_earns_by_flexion_and_share_of_work_and_only_downhill(knee, share, rho, force):
    posture = math.exp(-(((knee - 0.45 - 0.30 * rho) / 0.25) ** 2))
    alone = ([knee, 0.0], [force, 0.0], share, rho)
    assert brake(*alone, DOWN) == pytest.approx(posture * min(share / 0.45, 1.0))
    assert brake(*alone, FLAT) == brake(*alone, UP) == 0.0


def test_each_knee_counts_by_its_share_of_the_load_and_errors_of_two_knees_do_not_cancel():
    best, off = 0.75, 1.0
    both = [brake([best, off], load, 0.5, 1.0, DOWN) for load in ([300.0, 0.0], [225.0, 75.0], [0.0, 300.0])]
    assert both == pytest.approx([1.0, 0.75 + 0.25 * math.exp(-1.0), math.exp(-1.0)])
    assert brake([0.5, 1.0], [150.0, 150.0], 0.5, 1.0, DOWN) == pytest.approx(math.exp(-1.0))


def test_in_flight_no_knee_brakes():
    assert brake([0.75, 0.75], [0.0, 0.0], 0.5, 1.0, DOWN) == 0.0


# Stride


def stride(length, asked, rho, gates):
    _, down = gates
    longest = bsga.longest_step(scalar(asked), scalar(rho), bsga.STEP_TIME, bsga.STEP_MARGIN, bsga.STEP_SHORTENING)
    return bsga.stride_reward(scalar(length), longest, down, bsga.STRIDE_STD).item()


@given(length=st.floats(0.0, 0.8), asked=st.floats(0.0, 1.0), rho=shares)
def test_a_step_earns_in_full_up_to_the_longest_one_and_less_beyond_and_only_downhill(length, asked, rho):
    longest = (0.4 * asked + 0.05) * (1.0 - 0.25 * rho)
    assert stride(length, asked, rho, DOWN) == pytest.approx(math.exp(-max(0.0, length - longest) / 0.05))
    assert stride(length, asked, rho, FLAT) == stride(length, asked, rho, UP) == 0.0


# Swing


@given(error=st.floats(-1.0, 1.0))
def test_the_swinging_hip_earns_near_the_target_and_the_standing_one_nothing(error):
    bell = math.exp(-((error / 0.3) ** 2))

    def swing(left, right):
        hips = torch.tensor([[0.6 + error, 0.6]], dtype=torch.float64)
        return bsga.swing_reward(hips, torch.tensor([[left, right]]), scalar([0.6]), std=0.3).tolist()

    assert swing(True, False) == pytest.approx([bell])
    assert swing(False, True) == [1.0]
    assert swing(False, False) == [0.0]


# All


@given(
    slope=slopes,
    knee=st.tuples(st.floats(-1.0, 3.0), st.floats(-1.0, 3.0)),
    load=st.tuples(st.floats(0.0, 500.0), st.floats(0.0, 500.0)),
    share=shares,
    length=st.floats(0.0, 2.0),
)
def test_every_term_is_between_zero_and_one_and_the_same_in_the_mirror(slope, knee, load, share, length):
    rho = bsga.slope_intensity(scalar(slope), bsga.FULL_SLOPE).item()
    gates = regime(slope)
    swinging = torch.tensor([load[0] == 0.0, load[0] > 0.0])

    def terms(order):
        hips, legs = scalar(knee)[order], scalar(load)[order]
        return [
            hip(share, rho, gates),
            brake(scalar(knee)[order].tolist(), legs.tolist(), share, rho, gates),
            stride(length, 0.5, rho, gates),
            bsga.swing_reward(hips, swinging[order], scalar(0.5), 0.3).item(),
        ]

    values = terms([0, 1])
    assert all(0.0 <= value <= 1.0 for value in values)
    assert terms([1, 0]) == pytest.approx(values, abs=1e-8)
