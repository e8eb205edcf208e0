"""Rewards for walking on sloped ground. Every function returns [N]; the manager multiplies it by weight and time step.

The terms started from Unitree RL Lab's; heights, speeds and lean refer to the ground here, not to the world's
horizontal plane. The terms as published are in `unitree_rl_lab`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import torch
from torch import Tensor

from humoslope.managers.terms import StatefulTerm
from humoslope.mdp.footfalls import Landings
from humoslope.mdp.rate import RateOfChange
from humoslope.mdp.selection import JointPair, Joints, joint_mask, joint_pair
from humoslope.ranges import NotNegative, Positive, Range, Share

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


def track_slope_velocity_exp(env: Env, std: Positive) -> Tensor:
    """Reward for holding the commanded velocity along the ground, forward and left.

    The velocity is taken in the tangent plane of the ground below the root,
    so that climbing is not punished as vertical motion.

    Args:
        std: Speed error at which the reward has fallen to 1/e, m/s.
    """
    error = (env.commands.velocity[:, :2] - env.signals.root_lin_vel_t[:, :2]).square().sum(dim=1)
    return torch.exp(error / -(std**2))


def track_yaw_rate_exp(env: Env, std: Positive) -> Tensor:
    """Reward for turning about the vertical as commanded.

    Args:
        std: Error at which the reward has fallen to 1/e, rad/s.
    """
    return torch.exp((env.commands.velocity[:, 2] - yaw_rate(env)).square() / -(std**2))


def yaw_rate(env: Env) -> Tensor:
    """Angular velocity of the root about the vertical, [N] rad/s."""
    return -(env.signals.projected_gravity_b * env.signals.root_ang_vel_b).sum(dim=1)


class TrackMeanYawRate(StatefulTerm):
    """Reward for turning about the vertical as commanded, on average over the last steps.

    A walking body sways about the vertical by more than most commands ask for. In the mean over a stride that is gone,
    and what is left is how it turns.

    Args:
        std: Mean error at which the reward has fallen to 1/e, rad/s.
        memory_s: Time constant of the mean, s.
    """

    def __init__(self, env: Env, std: Positive, memory_s: Positive) -> None:
        self._std, self._keep = std, max(0.0, 1.0 - env.step_dt / memory_s)
        self._error = env.zeros()  # [N] rad/s

    def __call__(self, env: Env) -> Tensor:
        error = env.commands.velocity[:, 2] - yaw_rate(env)
        self._error = torch.lerp(error, self._error, self._keep)
        return torch.exp(self._error.square() / -(self._std**2))

    def reset(self, mask: Tensor) -> None:
        """Forgets the error of the envs in `mask`."""
        self._error = self._error.masked_fill(mask, 0.0)


def alive(env: Env) -> Tensor:
    """Constant 1: reward for every second that an episode lasts."""
    return torch.ones(env.num_envs, device=env.device)


def fall(env: Env) -> Tensor:
    """1 in the step in which an episode ends in failure, else 0."""
    return env.terminations.terminated.to(torch.float32)


def slope_normal_velocity_l2(env: Env) -> Tensor:
    """Squared speed of the root at right angles to the ground, (m/s)^2; vertical speed on the flat."""
    return env.signals.root_lin_vel_t[:, 2].square()


def ang_vel_xy_l2(env: Env) -> Tensor:
    """Squared roll and pitch rate of the root, summed, (rad/s)^2."""
    return env.signals.root_ang_vel_b[:, :2].square().sum(dim=1)


def roll_l2(env: Env) -> Tensor:
    """Squared sine of the root's roll."""
    return env.signals.projected_gravity_b[:, 1].square()


def pitch_l2(env: Env, slope_share: Share) -> Tensor:
    """Squared sine of the root's pitch beyond the lean that the slope allows.

    Walking up or down needs a lean; a pelvis kept upright is what holds a policy back beyond 20 degrees.

    Args:
        slope_share: Lean without cost, as a share of the ground's inclination.
    """
    free = torch.sin(slope_share * env.signals.slope_pitch.abs())
    return (env.signals.projected_gravity_b[:, 0].abs() - free).clamp(min=0.0).square()


def root_height_l2(env: Env, target: NotNegative) -> Tensor:
    """Squared error of the root's height above the ground below it, m^2.

    Args:
        target: Height, m.
    """
    return (env.signals.root_height - target).square()


class JointAccelerationL2(StatefulTerm):
    """Squared joint accelerations over one control step, summed, (rad/s^2)^2.

    Args:
        joints: Regular expression on whole joint names.
    """

    def __init__(self, env: Env, joints: Joints = ".*") -> None:
        self._rate = RateOfChange(env.step_dt)
        self._mask = joint_mask(env.robot, joints, env.device)

    def __call__(self, env: Env) -> Tensor:
        return self._rate(env.signals.joint_vel).square() @ self._mask

    def reset(self, mask: Tensor) -> None:
        """Makes the next acceleration of the envs in `mask` zero."""
        self._rate.reset(mask)


def action_rate_l2(env: Env) -> Tensor:
    """Squared change of the action over one step, summed."""
    return (env.actions.action - env.actions.previous_action).square().sum(dim=1)


class ActionAccelerationL2(StatefulTerm):
    """Squared second difference of the action over three steps, summed.

    It costs what changes direction in every step, which is chatter, four times as much as what `action_rate_l2` does.
    """

    def __init__(self, env: Env) -> None:
        self._change = env.zeros(env.robot.num_joints)  # [N, J] of the step before

    def __call__(self, env: Env) -> Tensor:
        change = env.actions.action - env.actions.previous_action
        acceleration, self._change = change - self._change, change
        return acceleration.square().sum(dim=1)

    def reset(self, mask: Tensor) -> None:
        """Forgets the change of the envs in `mask`."""
        self._change = self._change.masked_fill(mask[:, None], 0.0)


def joint_pos_limits(env: Env, soft: Annotated[float, Range(0.0, 1.0, open_low=True)], joints: Joints = ".*") -> Tensor:
    """Distance of the joints beyond the middle share of their range, summed, rad.

    Args:
        soft: Middle share of the range of every joint within which there is no penalty.
        joints: Regular expression on whole joint names.
    """
    low, high = env.joint_range.unbind(dim=1)
    margin = 0.5 * (1.0 - soft)
    pos = env.signals.joint_pos
    below, above = low.lerp(high, margin) - pos, pos - high.lerp(low, margin)
    return (below.relu() + above.relu()) @ joint_mask(env.robot, joints, env.device)


def energy(env: Env) -> Tensor:
    """Absolute mechanical power of the joints, summed, W."""
    return (env.signals.joint_vel * env.signals.joint_torque).abs().sum(dim=1)


def joint_deviation_l1(env: Env, joints: Joints) -> Tensor:
    """Distance of the joints from the default pose, summed, rad.

    Args:
        joints: Regular expression on whole joint names.
    """
    return (env.signals.joint_pos - env.default_joint_pos).abs() @ joint_mask(env.robot, joints, env.device)


def knee_flexion_l1(env: Env, free: NotNegative, knees: JointPair = ".*_knee_joint") -> Tensor:
    """Flexion of the knees beyond what is free, mean of both, rad: a straighter leg carries with less torque.

    Args:
        free: Flexion without cost, rad.
        knees: Joint pattern.
    """
    flexion = env.signals.joint_pos.index_select(1, joint_pair(env.robot, knees, env.device))  # [N, 2]
    return (flexion - free).relu().mean(dim=1)


def foot_slide(env: Env) -> Tensor:
    """Speed of the feet that touch the ground, summed, m/s."""
    return (env.signals.foot_lin_vel_w.norm(dim=2) * env.signals.foot_contact).sum(dim=1)


def foot_clearance_exp(env: Env, target: NotNegative, std: Positive, speed_scale: Positive) -> Tensor:
    """Reward for moving feet at a height above the ground.

    Args:
        target: Height of the sole over the ground below it, m.
        std: Height error of a fast foot at which the reward has fallen to 1/e, m.
        speed_scale: Inverse of the foot speed at which the height starts to count, s/m.
    """
    speed = env.signals.foot_lin_vel_w[:, :, :2].norm(dim=2)
    error = (env.signals.foot_height - target).square() * torch.tanh(speed_scale * speed)
    return torch.exp(error.sum(dim=1) / -(std**2))


def body_contact(env: Env, force: NotNegative) -> Tensor:
    """1 where the ground presses on anything but the feet, else 0.

    Args:
        force: Least force that counts, N.
    """
    return (env.signals.body_force > force).to(torch.float32)


def self_contact(env: Env, force: NotNegative) -> Tensor:
    """1 where two parts of the robot press on each other, else 0.

    Args:
        force: Force that the strongest contact must exceed to count, N.
    """
    return (env.signals.self_force > force).to(torch.float32)


class SingleStance(StatefulTerm):
    """Reward for time on one leg, so that the robot steps without a prescribed clock, and unhurriedly.

    The value is the time since a foot last landed, as a share of `cap`, and 0 after that time: a step of `cap` earns
    most per second, and to stay on one leg earns nothing. It counts while exactly one foot is down, and for `transfer`
    seconds after a landing with both, so that the weight may pass from leg to leg. It is 0 in envs that are commanded
    to stand.

    Args:
        cap: Time at which the reward is full and ends, s.
        transfer: Time after a landing for which both feet may be down, s.
    """

    def __init__(self, env: Env, cap: Positive, transfer: NotNegative = 0.0) -> None:
        self._cap, self._transfer = cap, transfer
        self._landings = Landings(env)
        self._since = env.zeros()  # [N] s since a foot last landed

    def __call__(self, env: Env) -> Tensor:
        landed = self._landings(env).any(dim=1)
        self._since = (self._since + env.step_dt).masked_fill(landed, 0.0)
        down = env.signals.foot_contact.sum(dim=1)
        counts = (down == 1) | ((down == 2) & (self._since < self._transfer))
        late = self._since > self._cap + 0.5 * env.step_dt
        return (self._since / self._cap) * (counts & env.commands.moving & ~late)

    def reset(self, mask: Tensor) -> None:
        """Sets the times of the envs in `mask` to zero."""
        self._landings.reset(mask)
        self._since = self._since.masked_fill(mask, 0.0)


class LandingRate(StatefulTerm):
    """Landings of feet per second: a price on every step, so that few long ones are better than many short ones."""

    def __init__(self, env: Env) -> None:
        self._landings = Landings(env)

    def __call__(self, env: Env) -> Tensor:
        return self._landings(env).sum(dim=1) / env.step_dt

    def reset(self, mask: Tensor) -> None:
        """Forgets the contacts of the envs in `mask`."""
        self._landings.reset(mask)
