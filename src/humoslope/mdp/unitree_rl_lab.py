"""Terms of Unitree RL Lab's velocity task for the G1 that this project's own recipe has replaced; for baselines.

They are written for level ground: speeds and lean refer to the world's horizontal plane, and heights to its origin.
Terms that are the same in both (alive, action rate, energy, ...) are in `rewards`.
Source: unitree_rl_lab, `velocity_env_cfg.py` of the G1 with 29 joints, July 2025, and the terms of Isaac Lab that it
uses.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from humoslope.ranges import Finite, NotNegative, Positive, Share

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


def track_horizontal_velocity_exp(env: Env, std: Positive) -> Tensor:
    """Reward for holding the commanded velocity in the horizontal plane, forward and left of the heading.

    Args:
        std: Speed error at which the reward has fallen to 1/e, m/s.
    """
    cos, sin = env.signals.heading_w.cos(), env.signals.heading_w.sin()
    x, y = env.signals.root_lin_vel_w[:, 0], env.signals.root_lin_vel_w[:, 1]
    velocity = torch.stack([cos * x + sin * y, cos * y - sin * x], dim=1)
    error = (env.commands.velocity[:, :2] - velocity).square().sum(dim=1)
    return torch.exp(-error / std**2)


def track_body_yaw_rate_exp(env: Env, std: Positive) -> Tensor:
    """Reward for turning about the root's own vertical axis as commanded.

    Args:
        std: Error at which the reward has fallen to 1/e, rad/s.
    """
    return torch.exp(-(env.commands.velocity[:, 2] - env.signals.root_ang_vel_b[:, 2]).square() / std**2)


def lin_vel_z_l2(env: Env) -> Tensor:
    """Squared speed of the root along its own vertical axis, (m/s)^2."""
    return env.signals.root_lin_vel_b[:, 2].square()


def flat_orientation_l2(env: Env) -> Tensor:
    """Squared sine of the root's lean away from the vertical."""
    return env.signals.projected_gravity_b[:, :2].square().sum(dim=1)


def base_height_world_l2(env: Env, target: Finite) -> Tensor:
    """Squared error of the root's world height, wherever the ground is, m^2.

    Args:
        target: World height, m.
    """
    return (env.signals.root_pos_w[:, 2] - target).square()


def joint_vel_l2(env: Env) -> Tensor:
    """Squared joint velocities, summed, (rad/s)^2."""
    return env.signals.joint_vel.square().sum(dim=1)


def gait_clock(env: Env, period: Positive, stance_share: Share, least_command: NotNegative) -> Tensor:
    """Number of feet in the contact state that a clock prescribes: 0, 1 or 2.

    The clock starts with the episode, and no observation shows it. The left foot is to stand in the first part of each
    period, the right one half a period later. The value is 0 in envs with next to no command.

    Args:
        period: Duration of a stride, s.
        stance_share: Share of the period in which a foot is to stand.
        least_command: Norm of the command (speeds in m/s, yaw rate in rad/s) above which the clock counts.
    """
    phase = env.episode_length_buf * (env.step_dt / period)
    expected = torch.stack([phase, phase + 0.5], dim=1).frac() < stance_share  # [N, 2]
    asked = env.commands.velocity.norm(dim=1) > least_command
    return (expected == env.signals.foot_contact).sum(dim=1) * asked


def foot_slide_horizontal(env: Env) -> Tensor:
    """Horizontal speed of the feet that touch the ground, summed, m/s."""
    return (env.signals.foot_lin_vel_w[:, :, :2].norm(dim=2) * env.signals.foot_contact).sum(dim=1)


def foot_clearance_world_exp(env: Env, target: Finite, std: Positive, speed_scale: Positive) -> Tensor:
    """Reward for moving feet at a world height, wherever the ground is.

    Args:
        target: World height of the sole, m.
        std: Height error of a fast foot at which the reward has fallen to 1/e, m.
        speed_scale: Inverse of the foot speed at which the height starts to count, s/m.
    """
    speed = env.signals.foot_lin_vel_w[:, :, :2].norm(dim=2)
    error = (env.signals.foot_pos_w[:, :, 2] - target).square() * torch.tanh(speed_scale * speed)
    return torch.exp(-error.sum(dim=1) / std**2)


def root_too_low_in_world(env: Env, height: Finite) -> Tensor:
    """Termination: the root is below a world height, wherever the ground is.

    Args:
        height: World height, m.
    """
    return env.signals.root_pos_w[:, 2] < height
