"""Observations. Every function returns [N, d] and says how it is mirrored.

Those of the first part are what the robot itself can measure; those of the second are privileged, for the critic only.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from humoslope.mdp import mirror
from humoslope.mdp.mirror import mirrored_as

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


@mirrored_as(mirror.axial)
def base_ang_vel(env: Env) -> Tensor:
    """Angular velocity of the root in its own frame, rad/s, [N, 3]."""
    return env.signals.root_ang_vel_b


@mirrored_as(mirror.polar)
def projected_gravity(env: Env) -> Tensor:
    """Direction of gravity in the root frame, [N, 3]."""
    return env.signals.projected_gravity_b


@mirrored_as(mirror.planar_velocity)
def velocity_command(env: Env) -> Tensor:
    """Commanded speed forward and left, m/s, and yaw rate, rad/s, [N, 3]."""
    return env.commands.velocity


@mirrored_as(mirror.joints)
def joint_pos_rel(env: Env) -> Tensor:
    """Joint positions relative to the default pose, rad, [N, J]."""
    return env.signals.joint_pos - env.default_joint_pos


@mirrored_as(mirror.joints)
def joint_vel(env: Env) -> Tensor:
    """Joint velocities, rad/s, [N, J]."""
    return env.signals.joint_vel


@mirrored_as(mirror.joints)
def last_action(env: Env) -> Tensor:
    """The last action, as the policy gave it, [N, J]."""
    return env.actions.action


# Privileged.


@mirrored_as(mirror.polar)
def base_lin_vel(env: Env) -> Tensor:
    """Velocity of the root in its own frame, m/s, [N, 3]."""
    return env.signals.root_lin_vel_b


@mirrored_as(mirror.feet)
def foot_contact(env: Env) -> Tensor:
    """Whether each foot touches the ground, [N, 2]."""
    return env.signals.foot_contact.to(torch.float32)


@mirrored_as(mirror.feet)
def foot_load(env: Env) -> Tensor:
    """Ground force on each foot in units of body weight, [N, 2]."""
    return env.signals.foot_force / (env.robot.total_mass * 9.81)


@mirrored_as(mirror.feet)
def foot_height(env: Env) -> Tensor:
    """Height of each sole above the ground below it, m, [N, 2]."""
    return env.signals.foot_height


@mirrored_as(mirror.itself)
def friction(env: Env) -> Tensor:
    """Friction coefficient between feet and ground, [N, 1]."""
    geom = env.sim.model.geom(env.robot.foot_geoms[0][0]).id
    return env.sim.expand("geom_friction")[:, geom, :1].to(torch.float32)


@lru_cache(maxsize=16)
def _grid(size: int, spacing: float, device: torch.device) -> Tensor:
    """Square grid of `size` x `size` points around the origin, forward first, [size^2, 2] m."""
    axis = (torch.arange(size, device=device) - 0.5 * (size - 1)) * spacing
    return torch.stack(torch.meshgrid(axis, axis, indexing="ij"), dim=-1).view(-1, 2)


def _scan_image(env: Env, size: int = 7, **params: object) -> mirror.Image:
    index = torch.arange(size * size).view(size, size).flip(1).flatten()
    return index, torch.ones(size * size)


@mirrored_as(_scan_image)
def height_scan(env: Env, size: int = 7, spacing: float = 0.2, clip: float = 1.0) -> Tensor:
    """H49: height of the root over a yaw-aligned grid of ground points, less its default, m, [N, size^2].

    Args:
        size: Points along each side of the square grid centred below the root. 7 x 7 = 49.
        spacing: Distance of the points, m. 0.2: one stride ahead at 0.5 m/s.
        clip: Largest absolute value, m.
    """
    ground = env.signals.ground_scan(_grid(size, spacing, env.device))
    height = (env.signals.root_pos_w[:, 2:3] - env.robot.default_root_height) - ground
    return height.clamp(-clip, clip)
