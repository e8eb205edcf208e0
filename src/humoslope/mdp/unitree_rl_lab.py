"""Terms of Unitree RL Lab's velocity task for the G1 that this project's own recipe has replaced; for baselines.

They are written for level ground: speeds, heights and lean refer to the world's horizontal plane, and heights to its
origin. Terms that are the same there and here (alive, action rate, energy, ...) are in `rewards`.
Source: unitree_rl_lab, `velocity_env_cfg.py` of the G1 with 29 joints, July 2025, and Isaac Lab's terms that it names.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


def track_horizontal_velocity_exp(env: Env, std: float) -> Tensor:
    """Reward for holding the commanded velocity in the horizontal plane, forward and left of the heading.

    Args:
        std: Speed error at which the reward has fallen to 1/e, m/s.
    """
    cos, sin = env.signals.heading_w.cos(), env.signals.heading_w.sin()
    x, y = env.signals.root_lin_vel_w[:, 0], env.signals.root_lin_vel_w[:, 1]
    velocity = torch.stack([cos * x + sin * y, cos * y - sin * x], dim=1)
    error = (env.commands.velocity[:, :2] - velocity).square().sum(dim=1)
    return torch.exp(-error / std**2)


def track_body_yaw_rate_exp(env: Env, std: float) -> Tensor:
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


def base_height_world_l2(env: Env, target: float) -> Tensor:
    """Squared error of the root's height in the world, whatever the ground below it, m^2.

    Args:
        target: World height, m.
    """
    return (env.signals.root_pos_w[:, 2] - target).square()


def joint_vel_l2(env: Env) -> Tensor:
    """Squared joint velocities, (rad/s)^2."""
    return env.signals.joint_vel.square().sum(dim=1)


def gait_clock(env: Env, period: float, stance_share: float, least_command: float) -> Tensor:
    """How many feet do what a clock expects of them: 0, 1 or 2.

    The clock starts with the episode, and no observation shows it. The left foot is to stand in the first part of each
    period, the right one half a period later. Worlds that are asked for next to nothing earn nothing.

    Args:
        period: Of a stride, s.
        stance_share: Part of the period that a foot is to stand.
        least_command: Length of the command (speeds in m/s, yaw rate in rad/s) above which the clock runs.
    """
    phase = env.episode_length_buf * (env.step_dt / period)
    expected = torch.stack([phase, phase + 0.5], dim=1).frac() < stance_share  # [N, 2]
    asked = env.commands.velocity.norm(dim=1) > least_command
    return (expected == env.signals.foot_contact).sum(dim=1) * asked


def foot_slide_horizontal(env: Env) -> Tensor:
    """Horizontal speed of the feet that touch the ground, m/s, summed."""
    return (env.signals.foot_lin_vel_w[:, :, :2].norm(dim=2) * env.signals.foot_contact).sum(dim=1)


def foot_clearance_world_exp(env: Env, target: float, std: float, speed_scale: float) -> Tensor:
    """Reward for feet that are at one height in the world while they move, whatever the ground below them.

    Args:
        target: World height of the sole, m.
        std: Height error of a fast foot at which the reward has fallen to 1/e, m.
        speed_scale: Inverse of the foot speed at which the height starts to count, s/m.
    """
    speed = env.signals.foot_lin_vel_w[:, :, :2].norm(dim=2)
    error = (env.signals.foot_pos_w[:, :, 2] - target).square() * torch.tanh(speed_scale * speed)
    return torch.exp(-error.sum(dim=1) / std**2)


def root_too_low_in_world(env: Env, height: float) -> Tensor:
    """Termination: the root is below `height` m in the world, whatever the ground below it."""
    return env.signals.root_pos_w[:, 2] < height
