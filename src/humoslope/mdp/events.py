"""Randomisation, resets and pushes. Every function acts on the worlds in `mask` [N]."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from humoslope.errors import UserError
from humoslope.slope import quaternion

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

Range = tuple[float, float]


def _set(field: Tensor, mask: Tensor, value: Tensor) -> None:
    """Writes `value` into `field` [N, ...] where `mask` [N] holds; broadcasts."""
    where = mask.view(-1, *[1] * (field.dim() - 1))
    field.copy_(torch.where(where, value.to(field.dtype), field))


def _check(name: str, bounds: Range, least: float = -float("inf")) -> None:
    low, high = bounds
    if not least <= low <= high:
        raise UserError(
            f"{name} ({low:g}, {high:g}) must be (lowest, highest)"
            + (f" and at least {least:g}." if least > -1e9 else ".")
        )


@lru_cache(maxsize=16)
def _stance(device: torch.device) -> Tensor:
    """Points around the root, [5, 2] m, that a standing robot covers."""
    return torch.tensor([[0.0, 0.0], [0.12, 0.12], [0.12, -0.12], [-0.12, 0.12], [-0.12, -0.12]], device=device)


def reset_on_tile(env: Env, mask: Tensor, along: Range, across: Range, yaw: Range, lift: float = 0.01) -> None:
    """Starts the robot in its default pose at the start of its tile, facing along it.

    Args:
        along, across: Offset from the tile's spawn place, m.
        yaw: Heading relative to the direction of travel, rad.
        lift: Height of the soles over the highest ground below the robot, m.
    """
    tiles, start = env.tiles, env.start_qpos
    x = tiles.origin_w[:, 0] + tiles.spawn_x + env.uniform(*along)
    y = tiles.origin_w[:, 1] + env.uniform(*across)
    xy = torch.stack([x, y], dim=1)
    # Highest of the ground under the stance, so that no foot starts in it.
    ground = env.terrain.height(xy[:, None] + _stance(env.device)).amax(dim=1)
    start[:, :2] = xy
    start[:, 2] += ground + lift
    start[:, 3:7] = quaternion.from_yaw(env.uniform(*yaw))


def reset_joints(env: Env, mask: Tensor, position: Range, velocity: Range) -> None:
    """Offsets every joint from the default pose, within its range.

    Args:
        position: rad.
        velocity: rad/s.
    """
    low, high = env.joint_range.unbind(dim=1)
    joints = env.start_qpos[:, 7:] + env.uniform(*position, env.robot.num_joints)
    env.start_qpos[:, 7:] = torch.minimum(torch.maximum(joints, low), high)
    env.start_qvel[:, 6:] = env.uniform(*velocity, env.robot.num_joints)


def push(env: Env, mask: Tensor, speed: float) -> None:
    """Changes the root's horizontal velocity by up to `speed` m/s along each axis."""
    qvel = env.sim.state("qvel")
    kick = env.uniform(-speed, speed, 2)
    _set(qvel[:, :2], mask, qvel[:, :2] + kick)


def randomize_friction(env: Env, mask: Tensor, friction: Range, slope_margin: float) -> None:
    """Draws the friction of feet on ground, relative to the slope.

    Args:
        friction: Range of the coefficient.
        slope_margin: The coefficient is at least tan(grade) plus this; otherwise a slope could not be climbed by
            anyone.
    """
    _check("friction", friction, 0.0)
    set_friction(env, mask, torch.maximum(env.uniform(*friction), torch.tan(env.tiles.grade.abs()) + slope_margin))


def set_friction(env: Env, mask: Tensor, mu: Tensor) -> None:
    """Sets the coefficient of friction `mu` [N] between feet and ground."""
    field = env.sim.expand("geom_friction")  # [N, G, 3]
    for side in env.robot.foot_geoms:
        for geom in side:
            _set(field[:, env.sim.model.geom(geom).id, 0], mask, mu)


def randomize_mass(env: Env, mask: Tensor, body: str, added: Range) -> None:
    """Adds mass to a body, in kg; its inertia scales with it."""
    _check("added mass", added)
    model, i = env.sim.model, env.body_id(body)
    if i < 0:
        raise UserError(f"randomize_mass: body '{body}' does not exist in {env.robot.name}.")
    mass = model.body_mass[i] + env.uniform(*added)
    if model.body_mass[i] + added[0] <= 0.0:
        raise UserError(
            f"randomize_mass: {body} weighs {model.body_mass[i]:.3g} kg; {added[0]:g} kg cannot be added to it."
        )
    inertia = torch.as_tensor(model.body_inertia[i], dtype=torch.float32, device=env.device)
    _set(env.sim.expand("body_mass")[:, i], mask, mass)
    _set(env.sim.expand("body_inertia")[:, i], mask, inertia * (mass / model.body_mass[i])[:, None])
    env.sim.recompute_constants()


def randomize_com(env: Env, mask: Tensor, body: str, offset: float) -> None:
    """Moves the centre of mass of a body by up to `offset` m along each axis."""
    i = env.body_id(body)
    if i < 0:
        raise UserError(f"randomize_com: body '{body}' does not exist in {env.robot.name}.")
    com = torch.as_tensor(env.sim.model.body_ipos[i], dtype=torch.float32, device=env.device)
    _set(env.sim.expand("body_ipos")[:, i], mask, com + env.uniform(-offset, offset, 3))
    env.sim.recompute_constants()


def randomize_gains(env: Env, mask: Tensor, stiffness: Range, damping: Range) -> None:
    """Scales the gains of every joint's position control, each on its own."""
    _check("stiffness", stiffness, 0.0)
    _check("damping", damping, 0.0)
    robot = env.robot
    kp = torch.tensor(robot.stiffness, device=env.device) * env.uniform(*stiffness, robot.num_joints)
    kd = torch.tensor(robot.damping, device=env.device) * env.uniform(*damping, robot.num_joints)
    # A MuJoCo position actuator: force = kp ctrl - kp q - kd dq.
    bias = env.sim.expand("actuator_biasprm")  # [N, J, 10]
    _set(env.sim.expand("actuator_gainprm")[:, :, 0], mask, kp)
    _set(bias[:, :, 1], mask, -kp)
    _set(bias[:, :, 2], mask, -kd)
