"""The rewards of the Biomechanical Slope Gait Adapter (BSGA; paper, section 3.2; mathematics in `slope/bsga.py`).

Every term is gated by `Progress`, so that standing still in a good posture earns nothing while walking is asked for.
`bsga.branch_weights` gives the weights under which the terms sum to the paper's core reward. The descriptor of a patch
that is not valid is flat: such a world is treated as on the flat.

Joints are named by patterns that match one left and one right joint. Their axes point to the robot's left, as usual:
a flexed knee is a positive angle, a flexed hip a negative one.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from humoslope.errors import require_positive
from humoslope.managers.terms import StatefulTerm
from humoslope.mdp.bsga_memory import (
    MEMORY,
    SWING_FORCE,
    SWING_LONGEST,
    SWING_SETTLE,
    AirTime,
    Progress,
    StanceWork,
    Swing,
)
from humoslope.mdp.selection import joint_pair
from humoslope.slope import bsga
from humoslope.slope.swing import SwingCalibration

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

HIP_PITCH, KNEE, ANKLE_PITCH = ".*_hip_pitch_joint", ".*_knee_joint", ".*_ankle_pitch_joint"


class ComHeight(StatefulTerm):
    """r_com: CoM height at its slope-conditioned target (eq. com_height).

    Worlds that are asked to stand earn it in full: there it is posture.

    Args:
        nominal: CoM height on the flat, m. For the G1 0.69: with straight legs it is 0.696, in Unitree RL Lab's default
            pose 0.690.
        std: Error at which the reward has fallen to 1/e, m.
        offset_up, offset_down: Added to the target at full slope, m.
        full_slope: Slope of full intensity, rad.
        memory_s: Over which progress is averaged, s.
    """

    def __init__(
        self,
        env: Env,
        nominal: float,
        std: float = bsga.COM_STD,
        offset_up: float = bsga.OFFSET_UP,
        offset_down: float = bsga.OFFSET_DOWN,
        full_slope: float = bsga.FULL_SLOPE,
        memory_s: float = MEMORY,
    ) -> None:
        require_positive("com height", nominal=nominal, std=std, full_slope=full_slope)
        self._nominal, self._std = nominal, std
        self._offset_up, self._offset_down = offset_up, offset_down
        self._full_slope = full_slope
        self._progress = Progress(env, memory_s)

    def __call__(self, env: Env) -> Tensor:
        height = bsga.com_height_over_slope(env.signals.com_height, env.height_scan.descriptor.slope)
        gate = torch.where(env.commands.moving, self._progress(env), 1.0)
        return bsga.com_height_reward(height, self.target(env), self._std) * gate

    def target(self, env: Env) -> Tensor:
        """Height [N] that is asked for at right angles to the slope, m; see `bsga.com_height_over_slope`."""
        ground = env.height_scan.descriptor
        rho = bsga.slope_intensity(ground.slope, self._full_slope)
        return bsga.com_height_target(
            ground.slope, rho, ground.up, ground.down, self._nominal, self._offset_up, self._offset_down
        )

    def reset(self, mask: Tensor) -> None:
        """Progress starts anew."""
        self._progress.reset(mask)


class HipPropulsion(StatefulTerm):
    """r_hip: uphill, the hips do their share of the positive work of the stance legs.

    Args:
        hip, knee, ankle: Joint patterns.
        level: Share that is asked for on the flat.
        rise: By how much it rises to full slope.
        full_slope: Slope of full intensity, rad.
        memory_s: Over which work and progress are averaged, s.
    """

    def __init__(
        self,
        env: Env,
        hip: str = HIP_PITCH,
        knee: str = KNEE,
        ankle: str = ANKLE_PITCH,
        level: float = bsga.HIP_SHARE,
        rise: float = bsga.HIP_SHARE_RISE,
        full_slope: float = bsga.FULL_SLOPE,
        memory_s: float = MEMORY,
    ) -> None:
        require_positive("hip propulsion", level=level, full_slope=full_slope)
        self._level, self._rise, self._full_slope = level, rise, full_slope
        self._work = StanceWork(env, (hip, knee, ankle), "positive", memory_s)
        self._progress = Progress(env, memory_s)

    def __call__(self, env: Env) -> Tensor:
        ground = env.height_scan.descriptor
        rho = bsga.slope_intensity(ground.slope, self._full_slope)
        share = self._work.share(env, joint=0)
        return bsga.hip_reward(share, rho, ground.up, self._level, self._rise) * self._progress(env)

    def reset(self, mask: Tensor) -> None:
        """Work and progress start anew."""
        self._work.reset(mask)
        self._progress.reset(mask)


class KneeBraking(StatefulTerm):
    """r_brake: downhill, flexed stance knees do the braking.

    Args:
        hip, knee, ankle: Joint patterns.
        flexion: Stance knee flexion that is asked for on the flat, rad.
        rise: By how much it rises to full slope, rad.
        std: Error at which the reward has fallen to 1/e, rad.
        full_share: Knee's share of the negative work from which the reward is full.
        full_slope: Slope of full intensity, rad.
        memory_s: Over which work and progress are averaged, s.
    """

    def __init__(
        self,
        env: Env,
        hip: str = HIP_PITCH,
        knee: str = KNEE,
        ankle: str = ANKLE_PITCH,
        flexion: float = bsga.KNEE_FLEXION,
        rise: float = bsga.KNEE_FLEXION_RISE,
        std: float = bsga.KNEE_STD,
        full_share: float = bsga.BRAKE_SHARE,
        full_slope: float = bsga.FULL_SLOPE,
        memory_s: float = MEMORY,
    ) -> None:
        require_positive("knee braking", std=std, full_share=full_share, full_slope=full_slope)
        self._flexion, self._rise, self._std = flexion, rise, std
        self._full_share, self._full_slope = full_share, full_slope
        self._knee = torch.tensor(joint_pair(env.robot, knee), device=env.device)
        self._work = StanceWork(env, (hip, knee, ankle), "negative", memory_s)
        self._progress = Progress(env, memory_s)

    def __call__(self, env: Env) -> Tensor:
        ground, signals = env.height_scan.descriptor, env.signals
        braking = bsga.brake_reward(
            signals.joint_pos.index_select(1, self._knee),
            signals.foot_force,
            self._work.share(env, joint=1),
            bsga.slope_intensity(ground.slope, self._full_slope),
            ground.down,
            self._flexion,
            self._rise,
            self._std,
            self._full_share,
        )
        return braking * self._progress(env)

    def reset(self, mask: Tensor) -> None:
        """Work and progress start anew."""
        self._work.reset(mask)
        self._progress.reset(mask)


class Stride(StatefulTerm):
    """r_stride: downhill, steps are no longer than the commanded speed needs.

    A step is measured when a foot lands that was in the air for `settle_s` while the other one carried: chatter of
    contacts is no step, and hops and strides of running have no length that would say anything. The length holds until
    the next touchdown, but only for `hold_s`: who slides down on both feet earns nothing.

    Args:
        step_time: Time of a step, s.
        margin: What a step may be longer than the commanded speed needs, m.
        shortening: Share by which steps shorten to full slope.
        std: Excess length at which the reward has fallen to 1/e, m.
        full_slope: Slope of full intensity, rad.
        force: Force from which a foot carries, N.
        settle_s: Time in the air before a touchdown counts, s.
        hold_s: Time for which a step counts, s; 1.0 is two and a half steps.
        memory_s: Over which progress is averaged, s.
    """

    def __init__(
        self,
        env: Env,
        step_time: float = bsga.STEP_TIME,
        margin: float = bsga.STEP_MARGIN,
        shortening: float = bsga.STEP_SHORTENING,
        std: float = bsga.STRIDE_STD,
        full_slope: float = bsga.FULL_SLOPE,
        force: float = SWING_FORCE,
        settle_s: float = SWING_SETTLE,
        hold_s: float = 1.0,
        memory_s: float = MEMORY,
    ) -> None:
        require_positive("stride", std=std, full_slope=full_slope)
        self._step_time, self._margin, self._shortening, self._std = step_time, margin, shortening, std
        self._full_slope, self._settle, self._hold = full_slope, settle_s, hold_s
        self._air = AirTime(env, force)
        self._length = env.zeros()  # [N] m of the last step
        self._age = env.zeros() + math.inf  # [N] s since then
        self._progress = Progress(env, memory_s)

    def __call__(self, env: Env) -> Tensor:
        ground, signals = env.height_scan.descriptor, env.signals
        before = self._air.time
        carries = self._air.step(env)
        landed = (carries & (before >= self._settle) & (before.flip(1) == 0.0)).any(dim=1)
        apart = signals.along_ground(signals.foot_pos_w[:, 0] - signals.foot_pos_w[:, 1])[:, 0].abs()
        self._length = torch.where(landed, apart, self._length)
        self._age = (self._age + env.step_dt).masked_fill(landed, 0.0)
        rho = bsga.slope_intensity(ground.slope, self._full_slope)
        asked = env.commands.velocity[:, 0]
        short = bsga.stride_reward(
            self._length, asked, rho, ground.down, self._step_time, self._margin, self._shortening, self._std
        )
        return short * (self._age <= self._hold) * self._progress(env)

    def reset(self, mask: Tensor) -> None:
        """No step was made yet."""
        self._air.reset(mask)
        self._age = self._age.masked_fill(mask, math.inf)
        self._progress.reset(mask)


class SwingHip(StatefulTerm):
    """r_swing: the hip of the swinging leg flexes as the slope asks (eq. swing_calibration).

    Args:
        beta0, beta1, theta_clip: Of the swing calibration: hip flexion on the flat, rad, its rise with the slope,
            rad/rad, and the slope from which it rises no more, rad.
        hip: Joint pattern.
        std: Error at which the reward has fallen to 1/e, rad.
        force, settle_s, longest_s: When a leg swings (see `Swing`), N and s.
        memory_s: Over which progress is averaged, s.
    """

    def __init__(
        self,
        env: Env,
        beta0: float,
        beta1: float,
        theta_clip: float,
        hip: str = HIP_PITCH,
        std: float = bsga.SWING_STD,
        force: float = SWING_FORCE,
        settle_s: float = SWING_SETTLE,
        longest_s: float = SWING_LONGEST,
        memory_s: float = MEMORY,
    ) -> None:
        require_positive("swing hip", std=std)
        self._calibration = SwingCalibration(beta0, beta1, theta_clip)
        self._std = std
        self._hip = torch.tensor(joint_pair(env.robot, hip), device=env.device)
        self._swing = Swing(env, force, settle_s, longest_s)
        self._progress = Progress(env, memory_s)

    def __call__(self, env: Env) -> Tensor:
        swinging = self._swing.step(env)
        flexion = -env.signals.joint_pos.index_select(1, self._hip)
        target = self._calibration.target(env.height_scan.descriptor.slope)
        return bsga.swing_reward(flexion, swinging, target, self._std) * self._progress(env)

    def reset(self, mask: Tensor) -> None:
        """Both feet carry, and progress starts anew."""
        self._swing.reset(mask)
        self._progress.reset(mask)
