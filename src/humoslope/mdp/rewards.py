"""Rewards for walking along sloped ground. Every function returns [N]; the manager multiplies by weight and time step.

The list starts from Unitree RL Lab's,
with everything that referred to the world's horizontal plane referred to the ground instead.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from humoslope.managers.terms import StatefulTerm
from humoslope.mdp.rate import RateOfChange
from humoslope.mdp.selection import joint_mask

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


def track_slope_velocity_exp(env: Env, std: float) -> Tensor:
    """Reward for holding the commanded velocity along the ground, forward and left.

    The velocity is taken in the tangent plane of the ground below the root,
    so that climbing is not punished as vertical motion.

    Args:
        std: Speed error at which the reward has fallen to 1/e, m/s.
    """
    error = (env.commands.velocity[:, :2] - env.signals.root_lin_vel_t[:, :2]).square().sum(dim=1)
    return torch.exp(error / -(std**2))


def track_yaw_rate_exp(env: Env, std: float) -> Tensor:
    """Reward for turning about the vertical as commanded.

    Args:
        std: Error at which the reward has fallen to 1/e, rad/s.
    """
    about_gravity = (env.signals.projected_gravity_b * env.signals.root_ang_vel_b).sum(dim=1)
    return torch.exp((env.commands.velocity[:, 2] + about_gravity).square() / -(std**2))


def alive(env: Env) -> Tensor:
    """One, always: an episode that goes on is worth something."""
    return torch.ones(env.num_envs, device=env.device)


def fall(env: Env) -> Tensor:
    """One in the step in which an episode ends in failure."""
    return env.terminations.terminated.to(torch.float32)


def slope_normal_velocity_l2(env: Env) -> Tensor:
    """Squared speed of the root out of the ground, (m/s)^2; stands for the vertical speed penalty on the flat."""
    return env.signals.root_lin_vel_t[:, 2].square()


def ang_vel_xy_l2(env: Env) -> Tensor:
    """Squared roll and pitch rate of the root, (rad/s)^2."""
    return env.signals.root_ang_vel_b[:, :2].square().sum(dim=1)


def roll_l2(env: Env) -> Tensor:
    """Squared sine of the root's roll."""
    return env.signals.projected_gravity_b[:, 1].square()


def pitch_l2(env: Env, slope_share: float) -> Tensor:
    """Squared sine of the root's pitch beyond what the slope allows.

    Walking up or down needs a lean; a pelvis kept upright is what holds a policy back beyond 20 degrees.

    Args:
        slope_share: Lean that costs nothing, as a share of the ground's inclination.
    """
    free = torch.sin(slope_share * env.signals.slope_pitch.abs())
    return (env.signals.projected_gravity_b[:, 0].abs() - free).clamp(min=0.0).square()


def root_height_l2(env: Env, target: float) -> Tensor:
    """Squared error of the root's height above the ground below it, m^2.

    Args:
        target: Height, m.
    """
    return (env.signals.root_height - target).square()


class JointAccelerationL2(StatefulTerm):
    """Squared joint accelerations over one control step, (rad/s^2)^2."""

    def __init__(self, env: Env) -> None:
        self._rate = RateOfChange(env.step_dt)

    def __call__(self, env: Env) -> Tensor:
        return self._rate(env.signals.joint_vel).square().sum(dim=1)

    def reset(self, mask: Tensor) -> None:
        """The next difference is no acceleration."""
        self._rate.reset(mask)


def action_rate_l2(env: Env) -> Tensor:
    """Squared change of the action over one step."""
    return (env.actions.action - env.actions.previous_action).square().sum(dim=1)


def joint_pos_limits(env: Env, soft: float) -> Tensor:
    """How far joints are outside the middle share `soft` of their range, rad, summed."""
    low, high = env.joint_range.unbind(dim=1)
    margin = 0.5 * (1.0 - soft)
    pos = env.signals.joint_pos
    below, above = low.lerp(high, margin) - pos, pos - high.lerp(low, margin)
    return (below.relu() + above.relu()).sum(dim=1)


def energy(env: Env) -> Tensor:
    """Mechanical power, positive and negative counted alike, W."""
    return (env.signals.joint_vel * env.signals.joint_torque).abs().sum(dim=1)


def joint_deviation_l1(env: Env, joints: str) -> Tensor:
    """Distance of the joints from the default pose, rad, summed.

    Args:
        joints: Regular expression on whole joint names.
    """
    return (env.signals.joint_pos - env.default_joint_pos).abs() @ joint_mask(env.robot, joints, env.device)


def foot_slide(env: Env) -> Tensor:
    """Speed of the feet that touch the ground, m/s, summed."""
    return (env.signals.foot_lin_vel_w.norm(dim=2) * env.signals.foot_contact).sum(dim=1)


def foot_clearance_exp(env: Env, target: float, std: float, speed_scale: float) -> Tensor:
    """Reward for feet that are high above the ground while they move.

    Args:
        target: Height of the sole over the ground below it, m.
        std: Height error of a fast foot at which the reward has fallen to 1/e, m.
        speed_scale: Inverse of the foot speed at which the height starts to count, s/m.
    """
    speed = env.signals.foot_lin_vel_w[:, :, :2].norm(dim=2)
    error = (env.signals.foot_height - target).square() * torch.tanh(speed_scale * speed)
    return torch.exp(error.sum(dim=1) / -(std**2))


def body_contact(env: Env, force: float) -> Tensor:
    """One where anything but the feet presses on the ground with more than `force` N."""
    return (env.signals.body_force > force).to(torch.float32)


class SingleStance(StatefulTerm):
    """Time on one leg: rewards stepping without prescribing a clock.

    The value is the shorter of the times that the two feet have been in their present mode, as a share of `cap` (s)
    and at most one; zero unless exactly one foot is down, and for worlds that are asked to stand.
    """

    def __init__(self, env: Env, cap: float) -> None:
        self._cap = cap
        self._contact = env.signals.foot_contact
        self._time_in_mode = env.zeros(2)  # [N, 2] s since the foot last landed or lifted

    def __call__(self, env: Env) -> Tensor:
        contact = env.signals.foot_contact
        changed = contact != self._contact
        self._time_in_mode = (self._time_in_mode + env.step_dt).masked_fill(changed, 0.0)
        self._contact = contact
        single = (contact[:, 0] != contact[:, 1]) & env.commands.moving
        return (self._time_in_mode.amin(dim=1) / self._cap).clamp(max=1.0) * single

    def reset(self, mask: Tensor) -> None:
        """Time starts anew."""
        self._time_in_mode = self._time_in_mode.masked_fill(mask[:, None], 0.0)
