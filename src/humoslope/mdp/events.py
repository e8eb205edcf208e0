"""Randomisation, resets and pushes. Every event acts on the envs in `mask` [N]."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import torch
from torch import Tensor

from humoslope.errors import UserError
from humoslope.managers.terms import StatefulTerm
from humoslope.mdp.harness import Harness
from humoslope.mdp.room import check_room
from humoslope.mdp.selection import Body, Found, body_id
from humoslope.mdp.soles import Soles
from humoslope.ranges import NotNegative, NotNegativeSpan, Range, Share, Span
from humoslope.sim.fields import replace
from humoslope.slope import quaternion

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

Factors = Annotated[tuple[float, float], Range(0.01, 10.0)]
"""Lowest and highest factor on a gain."""
Kick = Annotated[float, Range(0.0, 10.0)]
"""Change of a velocity at once, m/s."""


class ResetOnTile(StatefulTerm):
    """Reset event: starts the robot upright on its tile, with its soles just above the ground.

    On a tile that is walked along x it starts at the tile's spawn place. On one that is walked in any direction it
    starts anywhere, with any heading; `along`, `across` and `yaw` do not matter there.

    Whatever the ground and the heading, the lowest point of the feet relative to the ground is `lift` above it, in the
    pose that all reset events together have drawn, in whatever order.

    Args:
        along, across: Offset from the tile's spawn place, m.
        yaw: Heading relative to the direction of travel, rad.
        lift: Vertical distance of the soles from the ground, m.
        edge: Least distance of a start from the edges of a tile that is walked in any direction, m. Ours.

    Raises:
        UserError: If the tile is too short or too narrow for these offsets and the margins of `off_tile`, or for the
            commands.
    """

    def __init__(
        self, env: Env, along: Span, across: Span, yaw: Span, lift: NotNegative = 0.01, edge: NotNegative = 1.0
    ) -> None:
        self._env, self._along, self._across, self._yaw, self._lift = env, along, across, yaw, lift
        self._soles = Soles(env.sim.model, env.robot, env.device)
        self._edge = edge
        check_room(env, along, max(abs(offset) for offset in across), edge)

    def __call__(self, env: Env, mask: Tensor) -> None:
        tiles, start = env.tiles, env.start_qpos
        start[:, 0] = tiles.origin_w[:, 0] + tiles.spawn_x + env.uniform(*self._along)
        start[:, 1] = tiles.origin_w[:, 1] + env.uniform(*self._across)
        start[:, 3:7] = quaternion.from_yaw(env.uniform(*self._yaw))
        if tiles.has_omnidirectional:
            anywhere, room = env.uniform(0.0, 1.0, 3), 2.0 * self._edge
            x = tiles.origin_w[:, 0] + self._edge + (tiles.length - room) * anywhere[:, 0]
            y = tiles.origin_w[:, 1] + (tiles.width - room) * (anywhere[:, 1] - 0.5)
            free = tiles.omnidirectional
            start[:, :2] = torch.where(free[:, None], torch.stack([x, y], dim=1), start[:, :2])
            turned = quaternion.from_yaw(2.0 * torch.pi * anywhere[:, 2])
            start[:, 3:7] = torch.where(free[:, None], turned, start[:, 3:7])

    def reset(self, mask: Tensor) -> None:
        """Sets the height of the root. Called when all reset events have written their part of the start."""
        start = self._env.start_qpos
        rows = self._env.sim.known_rows(mask)
        drawn = start[rows]
        points = self._soles(drawn, quaternion.matrix(drawn[:, 3:7]))  # [n, P, 3] from the root
        ground = self._env.terrain.height(drawn[:, None, :2] + points[:, :, :2])
        start[rows, 2] = (ground - points[:, :, 2]).amax(dim=1) + self._lift


def reset_joints(env: Env, mask: Tensor, position: Span, velocity: Span) -> None:
    """Reset event: offsets every joint from the default pose, within its range.

    Args:
        position: Offset of the position, rad.
        velocity: Velocity, rad/s.
    """
    low, high = env.joint_range.unbind(dim=1)
    joints = env.start_qpos[:, 7:] + env.uniform(*position, env.robot.num_joints)
    env.start_qpos[:, 7:] = torch.minimum(torch.maximum(joints, low), high)
    env.start_qvel[:, 6:] = env.uniform(*velocity, env.robot.num_joints)


def _harness(env: Env, name: str) -> None:
    if name and (name not in env.cfg.events or env.cfg.events[name].func is not Harness):
        raise UserError(f"there is no Harness event of the name '{name}'.")


def push(
    env: Env,
    mask: Tensor,
    speed: Kick,
    harness: Annotated[str, Found(_harness)] = "",
    full_level: Annotated[int, Range(0, 1000)] = 0,
    least: Share = 0.4,
) -> None:
    """Changes the root's horizontal velocity at once.

    Args:
        speed: Largest change along world x and along world y, m/s.
        harness: Name of the `Harness` event: pushes grow with its strictness. Empty for full pushes from the start.
        full_level: Terrain level from which pushes are full; on easier ones they are smaller, so that it is not pushes
            that keep a robot there. 0 for full ones everywhere.
        least: Share of `speed` that pushes grow from.
    """
    qvel = env.sim.state("qvel")
    kick = env.uniform(-speed, speed, 2)
    grown = env.events[harness].strictness if harness else 1.0
    if full_level:
        grown = grown * (env.tiles.level[:, None] / full_level).clamp(max=1.0)  # [N, 1]
    if harness or full_level:
        kick = kick * (least + (1.0 - least) * grown)
    replace(qvel[:, :2], mask, qvel[:, :2] + kick)


def push_in_random_direction(env: Env, mask: Tensor, speed: Kick) -> None:
    """Changes the root's horizontal velocity at once, always by the same amount.

    Args:
        speed: Size of the change, m/s; its direction is uniform.
    """
    qvel, angle = env.sim.state("qvel"), env.uniform(0.0, 2.0 * torch.pi)
    kick = speed * torch.stack([angle.cos(), angle.sin()], dim=1)
    replace(qvel[:, :2], mask, qvel[:, :2] + kick)


def randomize_friction(env: Env, mask: Tensor, friction: NotNegativeSpan, slope_margin: NotNegative) -> None:
    """Draws the friction of feet on ground, and raises it to what the tile needs.

    A foot on the steepest stretch of the tile would slide for want of friction otherwise, whatever the policy does.

    Args:
        friction: Range of the coefficient.
        slope_margin: Least distance of the coefficient from the tangent of the tile's steepest inclination over the
            length of a stance (`Terrain.steepest`).
    """
    least = torch.tan(env.tiles.steepest) + slope_margin
    set_friction(env, mask, torch.maximum(env.uniform(*friction), least))


def set_friction(env: Env, mask: Tensor, mu: Tensor) -> None:
    """Sets the coefficient of friction `mu` [N] between feet and ground."""
    field = env.sim.expand("geom_friction")  # [N, G, 3]
    for side in env.robot.foot_geoms:
        for geom in side:
            replace(field[:, env.sim.model.geom(geom).id, 0], mask, mu)


def randomize_mass(
    env: Env, mask: Tensor, body: Body, added: Annotated[tuple[float, float], Range(-100.0, 100.0)]
) -> None:
    """Adds mass to a body, whose inertia scales with it.

    Args:
        body: Name of the body.
        added: Range of the added mass, kg.
    """
    i = body_id(env, body)
    env.masses.expect(slice(i, i + 1), added=added[0])
    env.masses.set(mask, slice(i, i + 1), added=env.uniform(*added, 1))


def randomize_com(env: Env, mask: Tensor, body: Body, offset: Annotated[float, Range(0.0, 1.0)]) -> None:
    """Moves the centre of mass of a body.

    Args:
        body: Name of the body.
        offset: Largest distance along each axis of the body, m.
    """
    i = body_id(env, body)
    com = env.masses.nominal_com[i] + env.uniform(-offset, offset, 3)
    replace(env.sim.expand("body_ipos")[:, i], mask, com)
    env.sim.recompute_constants()


def randomize_gains(env: Env, mask: Tensor, stiffness: Factors, damping: Factors) -> None:
    """Scales the gains of every joint's position control, each on its own.

    Args:
        stiffness, damping: Ranges of the factors.
    """
    drives, joints = env.drives, env.robot.num_joints
    kp = drives.nominal_stiffness * env.uniform(*stiffness, joints)
    kd = drives.nominal_damping * env.uniform(*damping, joints)
    drives.set(mask, stiffness=kp, damping=kd)
