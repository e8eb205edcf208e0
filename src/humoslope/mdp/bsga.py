"""Rewards of the Biomechanical Slope Gait Adapter (BSGA; paper, section 3.2; mathematics in `slope/bsga.py`).

All terms share the observer `SlopeGait`, which is named by the parameter `cue`. Every term is multiplied by its
progress, so that standing still in a good posture earns nothing while walking is commanded; this gate is ours.
`bsga.branch_weights` gives the weights under which the terms sum to the paper's core reward. The descriptor of a scan
without a plane is flat, and such an env is treated as on the flat.

Joints are named by patterns that match one left and one right joint. Their axes point to the robot's left, as usual:
a flexed knee is a positive angle, a flexed hip a negative one.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import torch
from torch import Tensor

from humoslope.managers.terms import StatefulTerm
from humoslope.mdp.bsga_memory import (
    SWING_FORCE,
    SWING_LONGEST,
    SWING_SETTLE,
    AirTime,
    StanceWork,
    Swing,
    slope_gait,
)
from humoslope.mdp.selection import JointPair, joint_pair
from humoslope.ranges import Finite, NotNegative, Positive, Range, Share
from humoslope.slope import bsga
from humoslope.slope.swing import SwingCalibration

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

HIP_PITCH, KNEE, ANKLE_PITCH = ".*_hip_pitch_joint", ".*_knee_joint", ".*_ankle_pitch_joint"

CUE = "slope_gait"
"""Name of the observer that is the terms' `SlopeGait`."""


class ComHeight(StatefulTerm):
    """Reward r_com for a CoM height at its slope-conditioned target (eq. com_height).

    It is paid in full in envs that are commanded to stand, where it is a matter of posture alone.

    Args:
        nominal: CoM height on the flat, m. For the G1 0.69: with straight legs it is 0.696, in Unitree RL Lab's default
            pose 0.690.
        std: Error at which the reward has fallen to 1/e, m.
        offset_up, offset_down: Addition to the target at full slope, uphill and downhill, m.
        cue: Name of the `SlopeGait` observer.
    """

    def __init__(
        self,
        env: Env,
        nominal: Positive,
        std: Positive = bsga.COM_STD,
        offset_up: Finite = bsga.OFFSET_UP,
        offset_down: Finite = bsga.OFFSET_DOWN,
        cue: str = CUE,
    ) -> None:
        self._nominal, self._std = nominal, std
        self._offset_up, self._offset_down = offset_up, offset_down
        self._cue = slope_gait(env, cue)

    def __call__(self, env: Env) -> Tensor:
        height = bsga.com_height_over_slope(env.signals.com_height, env.height_scan.descriptor.slope)
        gate = torch.where(env.commands.moving, self._cue.progress(env), 1.0)
        return bsga.com_height_reward(height, self.target(env), self._std) * gate

    def target(self, env: Env) -> Tensor:
        """Target height [N] at right angles to the slope, m; see `bsga.com_height_over_slope`."""
        ground = env.height_scan.descriptor
        return bsga.com_height_target(
            ground.slope, self._cue.rho(env), ground.up, ground.down, self._nominal, self._offset_up, self._offset_down
        )

    def reset(self, mask: Tensor) -> None:
        """The cue, which remembers, is reset by the environment."""


class HipPropulsion(StatefulTerm):
    """Reward r_hip, uphill, for hips that do their share of the positive work of the stance legs.

    Args:
        hip, knee, ankle: Joint patterns.
        level: Target share on the flat.
        rise: Rise of the target to full slope.
        cue: Name of the `SlopeGait` observer.
    """

    def __init__(
        self,
        env: Env,
        hip: JointPair = HIP_PITCH,
        knee: JointPair = KNEE,
        ankle: JointPair = ANKLE_PITCH,
        level: Positive = bsga.HIP_SHARE,
        rise: NotNegative = bsga.HIP_SHARE_RISE,
        cue: str = CUE,
    ) -> None:
        self._level, self._rise = level, rise
        self._cue = slope_gait(env, cue)
        self._work = StanceWork(env, (hip, knee, ankle), "positive", self._cue.gain)

    def __call__(self, env: Env) -> Tensor:
        rho, up = self._cue.rho(env), env.height_scan.descriptor.up
        share = self._work.share(env, joint=0)
        return bsga.hip_reward(share, rho, up, self._level, self._rise) * self._cue.progress(env)

    def reset(self, mask: Tensor) -> None:
        """Clears the work of the envs in `mask`."""
        self._work.reset(mask)


class KneeBraking(StatefulTerm):
    """Reward r_brake, downhill, for flexed stance knees that do the braking.

    Args:
        hip, knee, ankle: Joint patterns.
        flexion: Target flexion of the stance knee on the flat, rad.
        rise: Rise of the target to full slope, rad.
        std: Error at which the reward has fallen to 1/e, rad.
        full_share: Knee's share of the negative work from which the reward is full.
        cue: Name of the `SlopeGait` observer.
    """

    def __init__(
        self,
        env: Env,
        hip: JointPair = HIP_PITCH,
        knee: JointPair = KNEE,
        ankle: JointPair = ANKLE_PITCH,
        flexion: Finite = bsga.KNEE_FLEXION,
        rise: Finite = bsga.KNEE_FLEXION_RISE,
        std: Positive = bsga.KNEE_STD,
        full_share: Annotated[float, Range(0.0, 1.0, open_low=True)] = bsga.BRAKE_SHARE,
        cue: str = CUE,
    ) -> None:
        self._flexion, self._rise, self._std, self._full_share = flexion, rise, std, full_share
        self._knee = joint_pair(env.robot, knee, env.device)
        self._cue = slope_gait(env, cue)
        self._work = StanceWork(env, (hip, knee, ankle), "negative", self._cue.gain)

    def __call__(self, env: Env) -> Tensor:
        braking = bsga.brake_reward(
            env.signals.joint_pos.index_select(1, self._knee),
            env.signals.foot_force,
            self._work.share(env, joint=1),
            env.height_scan.descriptor.down,
            target=self._flexion + self._rise * self._cue.rho(env),
            std=self._std,
            full_share=self._full_share,
        )
        return braking * self._cue.progress(env)

    def reset(self, mask: Tensor) -> None:
        """Clears the work of the envs in `mask`."""
        self._work.reset(mask)


class Stride(StatefulTerm):
    """Reward r_stride, downhill, for steps no longer than the commanded speed needs.

    A step is measured when a foot lands that was in the air for `settle_s` while the other one carried, so that chatter
    of contacts, hops and running strides do not count. The length holds until the next touchdown, but no longer than
    `hold_s`, so that sliding down on both feet earns nothing.

    Args:
        step_time: Time of a step, s.
        margin: Length by which a step may exceed that which the commanded speed needs, m.
        shortening: Share by which steps shorten to full slope.
        std: Excess length at which the reward has fallen to 1/e, m.
        force: Contact force from which a foot carries, N.
        settle_s: Time in the air before a touchdown counts, s.
        hold_s: Time for which a step counts, s; 1.0 is two and a half steps.
        cue: Name of the `SlopeGait` observer.
    """

    def __init__(
        self,
        env: Env,
        step_time: Positive = bsga.STEP_TIME,
        margin: NotNegative = bsga.STEP_MARGIN,
        shortening: Share = bsga.STEP_SHORTENING,
        std: Positive = bsga.STRIDE_STD,
        force: Positive = SWING_FORCE,
        settle_s: NotNegative = SWING_SETTLE,
        hold_s: Positive = 1.0,
        cue: str = CUE,
    ) -> None:
        self._step_time, self._margin, self._shortening, self._std = step_time, margin, shortening, std
        self._settle, self._hold = (round(seconds / env.step_dt) for seconds in (settle_s, hold_s))
        self._air = AirTime(env, force)
        self._length = env.zeros()  # [N] m of the last step
        self._age = env.zeros() + math.inf  # [N] control steps since then
        self._cue = slope_gait(env, cue)

    def __call__(self, env: Env) -> Tensor:
        signals = env.signals
        before = self._air.steps
        carries = self._air.step(env)
        landed = (carries & (before >= self._settle) & (before.flip(1) == 0.0)).any(dim=1)
        apart = signals.along_ground(signals.foot_pos_w[:, 0] - signals.foot_pos_w[:, 1])[:, 0].abs()
        self._length = torch.where(landed, apart, self._length)
        self._age = (self._age + 1.0).masked_fill(landed, 0.0)
        longest = bsga.longest_step(
            env.commands.velocity[:, 0].abs(), self._cue.rho(env), self._step_time, self._margin, self._shortening
        )
        short = bsga.stride_reward(self._length, longest, env.height_scan.descriptor.down, self._std)
        return short * (self._age <= self._hold) * self._cue.progress(env)

    def reset(self, mask: Tensor) -> None:
        """Clears the steps of the envs in `mask`."""
        self._air.reset(mask)
        self._age = self._age.masked_fill(mask, math.inf)


class SwingHip(StatefulTerm):
    """Reward r_swing for a hip of the swinging leg flexed as the slope needs it (eq. swing_calibration).

    Args:
        beta0: Target hip flexion on the flat, rad.
        beta1: Rise of the target with the slope, rad/rad.
        theta_clip: Slope from which the target rises no more, rad.
        hip: Joint pattern.
        std: Error at which the reward has fallen to 1/e, rad.
        force: Contact force from which a foot carries, N.
        settle_s, longest_s: Time after lift-off from and up to which a leg swings (see `Swing`), s.
        cue: Name of the `SlopeGait` observer.
    """

    def __init__(
        self,
        env: Env,
        beta0: Finite,
        beta1: Finite,
        theta_clip: Annotated[float, Range(0.0, 0.5 * math.pi, open_low=True, open_high=True)],
        hip: JointPair = HIP_PITCH,
        std: Positive = bsga.SWING_STD,
        force: Positive = SWING_FORCE,
        settle_s: NotNegative = SWING_SETTLE,
        longest_s: Positive = SWING_LONGEST,
        cue: str = CUE,
    ) -> None:
        self._calibration = SwingCalibration(beta0, beta1, theta_clip)
        self._std = std
        self._hip = joint_pair(env.robot, hip, env.device)
        self._swing = Swing(env, force, settle_s, longest_s)
        self._cue = slope_gait(env, cue)

    def __call__(self, env: Env) -> Tensor:
        swinging = self._swing.step(env)
        flexion = -env.signals.joint_pos.index_select(1, self._hip)
        target = self._calibration.target(env.height_scan.descriptor.slope)
        return bsga.swing_reward(flexion, swinging, target, self._std) * self._cue.progress(env)

    def reset(self, mask: Tensor) -> None:
        """Clears the swing of the envs in `mask`."""
        self._swing.reset(mask)
