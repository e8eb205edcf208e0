"""Observations. Every function returns [N, d] and declares its mirror image.

The robot itself can measure those of the first part; those of the second part are privileged, for the critic only.
With `measured` an observation is what the robot's own sensors report, with their errors and at their age (see
`Measurements`); without, it is the truth of one physics step ago.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from humoslope.mdp import declare
from humoslope.mdp.declare import measured_as, mirrored_as
from humoslope.ranges import Limit
from humoslope.slope.descriptor import phi5
from humoslope.slope.zmp import GRAVITY

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env
    from humoslope.scene.measurements import Measurements
    from humoslope.scene.signals import Signals


def _source(env: Env, measured: bool) -> Measurements | Signals:
    return env.measurements if measured else env.signals


@mirrored_as(declare.axial)
@measured_as("root_angular_velocity")
def base_ang_vel(env: Env, measured: bool = False) -> Tensor:
    """Angular velocity of the root in its own frame, rad/s, [N, 3].

    Args:
        measured: Take what the robot's sensors report, with their errors and at their age.
    """
    return _source(env, measured).root_ang_vel_b


@mirrored_as(declare.polar)
@measured_as("gravity_direction")
def projected_gravity(env: Env, measured: bool = False) -> Tensor:
    """Direction of gravity in the root frame, [N, 3].

    Args:
        measured: Take what the robot's sensors report, with their errors and at their age.
    """
    return _source(env, measured).projected_gravity_b


@mirrored_as(declare.planar_velocity)
@measured_as("velocity_command")
def velocity_command(env: Env) -> Tensor:
    """Commanded speed forward and left, m/s, and yaw rate, rad/s, [N, 3]."""
    return env.commands.velocity


@mirrored_as(declare.joints)
@measured_as("joint_position_offset")
def joint_pos_rel(env: Env, measured: bool = False) -> Tensor:
    """Joint positions relative to the default pose, rad, [N, J].

    Args:
        measured: Take what the robot's sensors report, with their errors and at their age.
    """
    return _source(env, measured).joint_pos - env.default_joint_pos


@mirrored_as(declare.joints)
@measured_as("joint_velocity")
def joint_vel(env: Env, measured: bool = False) -> Tensor:
    """Joint velocities, rad/s, [N, J].

    Args:
        measured: Take what the robot's sensors report, with their errors and at their age.
    """
    return _source(env, measured).joint_vel


@mirrored_as(declare.joints)
@measured_as("last_action")
def last_action(env: Env) -> Tensor:
    """Last action of the policy, [N, J]."""
    return env.actions.action


# Privileged.


@mirrored_as(declare.polar)
def base_lin_vel(env: Env) -> Tensor:
    """Velocity of the root in its own frame, m/s, [N, 3]."""
    return env.signals.root_lin_vel_b


@mirrored_as(declare.feet)
def foot_contact(env: Env) -> Tensor:
    """1 for each foot that touches the ground, else 0, [N, 2]."""
    return env.signals.foot_contact.to(torch.float32)


@mirrored_as(declare.feet)
def foot_load(env: Env) -> Tensor:
    """Ground force on each foot in units of body weight, [N, 2]."""
    return env.signals.foot_force / (env.robot.total_mass * GRAVITY)


@mirrored_as(declare.feet)
def foot_height(env: Env) -> Tensor:
    """Height of each sole above the ground below it, m, [N, 2]."""
    return env.signals.foot_height


@mirrored_as(declare.itself)
def friction(env: Env) -> Tensor:
    """Friction coefficient between feet and ground, [N, 1]."""
    geom = env.sim.model.geom(env.robot.foot_geoms[0][0]).id
    return env.sim.expand("geom_friction")[:, geom, :1].to(torch.float32)


def _scan_image(env: Env, **params: object) -> declare.Image:
    size = env.height_scan.cfg.size
    index = torch.arange(size * size).view(size, size).flip(1).flatten()
    return index, torch.ones(size * size)


@mirrored_as(_scan_image)
def height_scan(env: Env, clip: Limit = 1.0) -> Tensor:
    """Height of the root above each point of the height scan, less its default, m, [N, P].

    The paper's "compressed height scan H49". It does not say how it is compressed; taking the 49 heights of a 7 x 7
    grid as they are is ours.

    Args:
        clip: Bound on the absolute value, m. Ours.
    """
    height = (env.signals.root_pos_w[:, 2:3] - env.robot.default_root_height) - env.height_scan.heights_w
    return height.clamp(-clip, clip)


def _descriptor_image(env: Env, **params: object) -> declare.Image:
    return torch.arange(5), torch.tensor([1.0, -1.0, 1.0, 1.0, 1.0])


@mirrored_as(_descriptor_image)
def terrain_descriptor(env: Env) -> Tensor:
    """Descriptor phi5 of the scanned ground: slope, bank and |slope| in rad, and flags for up and down, [N, 5]."""
    return phi5(env.height_scan.descriptor)
