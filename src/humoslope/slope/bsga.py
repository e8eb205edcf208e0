"""Rewards of the Biomechanical Slope Gait Adapter (BSGA; paper, section 3.2) as pure functions.

[...] is any batch shape, and a last axis of 2 the left and the right leg. Angles are in rad, slopes positive uphill;
`up` and `down` are the terrain descriptor's 1_up and 1_down (bool). Hip and knee angles count flexion as positive.

The paper gives the structure (eq. bsga_core, com_height, bio_prior, swing_calibration) and leaves shapes and numbers
open. Both are ours: each constant comes with the source of its value, and is the default of a parameter of the terms in
`mdp/bsga.py`. The gate by progress is ours too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from humoslope.errors import UserError

FULL_SLOPE = math.radians(30.0)
"""Slope of full intensity, rad: the steepest grade of the paper's evaluation."""

COM_STD = 0.10
"""CoM height error at which r_com is 1/e, m. Crouched gaits are 0.13 to 0.15 m too low; at half this width they would
get no gradient."""

OFFSET_UP, OFFSET_DOWN = 0.01, -0.03
"""b_up and b_down of eq. com_height, m: nearly upright uphill, more flexed downhill, as the paper's figures show."""

HIP_SHARE, HIP_SHARE_RISE = 0.33, 0.17
"""Hip's share of positive leg work on the flat, and its rise to full slope: 0.33 on the level (Montgomery & Grabowski
2018), 0.50 uphill (Nuckols et al. 2020 found 0.52 at 15 %)."""

KNEE_FLEXION, KNEE_FLEXION_RISE = 0.45, 0.30
"""Stance knee flexion while braking, rad, and its rise to full slope. With legs upright this lowers the G1's CoM from
0.685 to 0.663 m, which is what OFFSET_DOWN asks for."""

KNEE_STD = 0.25
"""Knee error at which r_brake is 1/e, rad."""

BRAKE_SHARE = 0.45
"""Knee's share of negative leg work from which r_brake is full: 0.39 to 0.45 from -9 to 9 degrees (Montgomery &
Grabowski 2018)."""

STEP_TIME, STEP_MARGIN = 0.4, 0.05
"""Time of a step, s (half the gait period of 0.8 s in Unitree RL Lab), and tolerated excess length, m."""

STEP_SHORTENING = 0.25
"""Share by which steps shorten to full slope. Franz & Kram (2012) measured 13 % at -9 degrees and 0.75 m/s; 25 % at
30 degrees carries that on with caution."""

STRIDE_STD = 0.05
"""Excess step length at which r_stride is 1/e, m."""

SWING_STD = 0.3
"""Hip error at which r_swing is 1/e, rad: soft, as the target is a trend over slopes and not a trajectory."""

LEAST_POWER = 0.15
"""Leg power per mass below which work shares fade to zero, W/kg: a tenth of what climbing 20 degrees at 0.5 m/s takes
(1.7 W/kg)."""

LEAST_SPEED = 0.1
"""A smaller commanded speed counts as this one, m/s, so that swaying on the spot is no progress."""


class BranchWeights(NamedTuple):
    """Weights of the five terms whose sum is eq. bsga_core."""

    com: float
    hip: float
    brake: float
    stride: float
    swing: float


def branch_weights(
    w_com: float = 1.0,
    w_bio: float = 0.25,
    w_swing: float = 0.25,
    w_up: float = 1.0,
    w_down: float = 1.0,
    lambda_brake: float = 0.7,
    lambda_stride: float = 0.3,
) -> BranchWeights:
    """Returns eq. bsga_core and eq. bio_prior as one weight per term:

    r_core = w_com r_com + w_bio (w_up r_hip + w_down (lambda_brake r_brake + lambda_stride r_stride)) / (w_up + w_down)
    + w_swing r_swing.

    The paper calls the biomechanical branch low-weight; the gates of ascent and descent exclude each other, so with the
    defaults it is at most half of `w_bio`. All weights are per second, next to a velocity tracking weight of 1 to 2.
    The numbers are ours.

    Raises:
        UserError: If `w_up` + `w_down` is not positive.
    """
    if w_up + w_down <= 0.0:
        raise UserError(f"BSGA: w_up {w_up:g} and w_down {w_down:g} must have a positive sum.")
    up, down = w_bio * w_up / (w_up + w_down), w_bio * w_down / (w_up + w_down)
    return BranchWeights(com=w_com, hip=up, brake=down * lambda_brake, stride=down * lambda_stride, swing=w_swing)


def progress(velocity: Tensor, asked: Tensor, least: float) -> Tensor:
    """Gate of all terms: share of the commanded speed that is walked in the commanded direction, [...] in [0, 1]; zero
    where none is commanded.

    Without it a robot would earn most of BSGA by standing in the right posture.

    Args:
        velocity: [..., 2] velocity along the ground, forward and left, m/s.
        asked: [..., 2] commanded velocity, m/s.
        least: m/s, see LEAST_SPEED.
    """
    speed = asked.norm(dim=-1)
    along = (velocity * asked).sum(dim=-1) / speed.clamp(min=1e-6)
    return (along / speed.clamp(min=least)).clamp(0.0, 1.0) * (speed > 0.0)


def slope_intensity(slope: Tensor, full: float) -> Tensor:
    """Normalised slope intensity rho_slope in [0, 1] (before eq. com_height), 1 from `full` rad on; [...]."""
    return (slope.abs() / full).clamp(max=1.0)


def com_height_target(
    slope: Tensor, rho: Tensor, up: Tensor, down: Tensor, nominal: float, offset_up: float, offset_down: float
) -> Tensor:
    """Target h_tgt of the CoM height (eq. com_height), [...] m; to be compared with `com_height_over_slope`.

    Args:
        nominal: h_nom, CoM height on the flat, m.
        offset_up, offset_down: b_up and b_down, m.
    """
    return nominal * slope.cos() + rho * (offset_up * up + offset_down * down)


def com_height_over_slope(clearance: Tensor, slope: Tensor) -> Tensor:
    """Height of the CoM over the ground's line in the heading plane, at right angles to it, [...] m.

    The paper does not say how its height is measured. A leg that is as long as on the flat and upright has its CoM
    h_nom above the ground vertically, and h_nom cos(slope) at right angles: with this measure the cosine of eq.
    com_height leaves the leg as it is, and with the vertical one it would ask for a crouch of 9 cm at 30 degrees.
    On a plane without bank this is the distance to the plane along its normal. Bank is left out, because eq. com_height
    leaves it out.

    Args:
        clearance: [...] CoM above the ground below it, vertically, m.
        slope: [...] rad.
    """
    return clearance * slope.cos()


def com_height_reward(height: Tensor, target: Tensor, std: float) -> Tensor:
    """r_com = exp(-(e / std)^2) of the error e = height - target (m), [...]."""
    return torch.exp(-((height - target) / std).square())


def work_share(part: Tensor, total: Tensor, least: float) -> Tensor:
    """Share of `part` in `total` (W, [...], neither negative), fading to zero where the total is below `least` W."""
    return part / total.clamp(min=least)


def hip_reward(share: Tensor, rho: Tensor, up: Tensor, level: float, rise: float) -> Tensor:
    """r_hip = 1_up min(s / s*, 1) with s* = level + rise rho (in eq. bio_prior): hip-dominant propulsion, [...].

    Args:
        share: Hip's share s of the positive work of hip, knee and ankle.
    """
    return (share / (level + rise * rho)).clamp(max=1.0) * up


def brake_reward(
    knee: Tensor, load: Tensor, share: Tensor, down: Tensor, *, target: Tensor, std: float, full_share: float
) -> Tensor:
    """r_brake = 1_down exp(-((q - q*) / std)^2) min(s / full_share, 1) (in eq. bio_prior).

    Rewards knees that are flexed while they carry and do the braking, [...]. Each leg counts by its share of the load,
    so that the value does not jump when the weight changes legs; in flight it is zero.

    Args:
        knee: [..., 2] knee flexion q, rad.
        load: [..., 2] contact force, N.
        share: [...] knee's share s of the negative work of hip, knee and ankle.
        target: [...] flexion q*, rad.
    """
    posture = torch.exp(-((knee - target.unsqueeze(-1)) / std).square())  # [..., 2]
    # At least a newton, so that flight divides by something.
    stance = (posture * load).sum(dim=-1) / load.sum(dim=-1).clamp(min=1.0)
    return stance * (share / full_share).clamp(max=1.0) * down


def longest_step(asked: Tensor, rho: Tensor, step_time: float, margin: float, shortening: float) -> Tensor:
    """Longest step without cost, L* = (v step_time + margin) (1 - shortening rho), [...] m.

    Args:
        asked: [...] commanded forward speed v, m/s.
    """
    return (asked * step_time + margin) * (1.0 - shortening * rho)


def stride_reward(length: Tensor, longest: Tensor, down: Tensor, std: float) -> Tensor:
    """r_stride = 1_down exp(-max(0, L - L*) / std), [...]; over-stepping downhill costs (in eq. bio_prior).

    Args:
        length: [...] distance L of the feet along the heading at touchdown, m.
        longest: [...] L*, m, see `longest_step`.
    """
    return torch.exp((longest - length).clamp(max=0.0) / std) * down


def swing_reward(hip: Tensor, swinging: Tensor, target: Tensor, std: float) -> Tensor:
    """r_swing = exp(-((q - q*) / std)^2) with q* of eq. swing_calibration, summed over the legs that swing, [...].

    Args:
        hip: [..., 2] hip flexion q, rad.
        swinging: [..., 2] bool.
        target: [...] q*, rad, by `SwingCalibration.target`.
    """
    return (torch.exp(-((hip - target.unsqueeze(-1)) / std).square()) * swinging).sum(dim=-1)
