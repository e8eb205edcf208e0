"""Terms of Unitree's MuJoCo task for the G1 on rough ground that no other task here has; for a baseline.

Source: unitree_rl_mjlab, `unitree_g1_rough_env_cfg` and the terms that it uses, February 2026. What is kept, changed
and left out is listed in docs/unitree_mjlab.md. As published, velocities are in the frame of the root, with all of its
lean.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from humoslope.errors import UserError
from humoslope.managers.terms import StatefulTerm
from humoslope.mdp import gallant
from humoslope.mdp.footfalls import Landings, TimeOnOneLeg
from humoslope.ranges import NotNegative, Positive

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

LEAST_COMMAND = 0.1
"""Size of a command, see `size_of_command`, up to which it counts as one to stand."""


def size_of_command(env: Env) -> Tensor:
    """Commanded speed in m/s plus the yaw rate in rad/s, [N]."""
    command = env.commands.velocity
    return command[:, :2].norm(dim=1) + command[:, 2].abs()


def track_body_velocity_exp(env: Env, std: Positive, z_share: NotNegative = 2.0) -> Tensor:
    """Reward for holding the commanded velocity along the root's own axes, and none upward.

    Args:
        std: Speed error at which the reward has fallen to 1/e, m/s.
        z_share: Weight of the squared upward speed beside the squared error of the two others.
    """
    velocity = env.signals.root_lin_vel_b
    error = (env.commands.velocity[:, :2] - velocity[:, :2]).square().sum(dim=1)
    return torch.exp(torch.add(error, velocity[:, 2].square(), alpha=z_share) / -(std**2))


def track_body_turning_exp(env: Env, std: Positive, xy_share: NotNegative = 0.05) -> Tensor:
    """Reward for turning about the root's own vertical axis as commanded, and not about the two others.

    Args:
        std: Error at which the reward has fallen to 1/e, rad/s.
        xy_share: Weight of the squared rates of roll and pitch beside the squared error of the yaw rate.
    """
    rate = env.signals.root_ang_vel_b
    error = (env.commands.velocity[:, 2] - rate[:, 2]).square()
    return torch.exp(torch.add(error, rate[:, :2].square().sum(dim=1), alpha=xy_share) / -(std**2))


class PostureExp(StatefulTerm):
    """exp(-m) of the mean m over all joints of (distance from the default pose / tolerance)^2.

    The tolerances follow the size of the command, speed in m/s plus yaw rate in rad/s.

    Args:
        standing: Tolerance of every joint for commands of a size below `walk`, rad.
        walking: Tolerances from `walk` on, rad, each for the joints in whose name its key occurs.
        running: Tolerances from `run` on, in the same way.
        walk, run: Sizes of a command from which one walks and runs.

    Raises:
        UserError: If a joint has no tolerance or two of them, or a key occurs in no name.
    """

    def __init__(
        self,
        env: Env,
        standing: Positive,
        walking: Mapping[str, Positive],
        running: Mapping[str, Positive],
        walk: NotNegative = LEAST_COMMAND,
        run: NotNegative = 1.5,
    ) -> None:
        self._walk, self._run = walk, run
        names = env.robot.joint_names
        rows = [[standing] * len(names), _tolerances("walking", walking, names), _tolerances("running", running, names)]
        self._tolerance = torch.tensor(rows, device=env.device)  # [3, J] rad

    def __call__(self, env: Env) -> Tensor:
        size = size_of_command(env)
        tolerance = self._tolerance[(size >= self._walk).long() + (size >= self._run)]  # [N, J]
        off = (env.signals.joint_pos - env.default_joint_pos) / tolerance
        return torch.exp(-off.square().mean(dim=1))

    def reset(self, mask: Tensor) -> None:
        """Nothing to forget."""


def _tolerances(gait: str, given: Mapping[str, float], names: tuple[str, ...]) -> list[float]:
    """The tolerance of each joint, rad."""
    for key in given:
        if not any(key in name for name in names):
            raise UserError(f"{gait}: '{key}' occurs in no joint's name; there are {', '.join(names[:4])}, ...")
    found = [[key for key in given if key in name] for name in names]
    for name, keys in zip(names, found, strict=True):
        if len(keys) != 1:
            what = f"those of {' and '.join(keys)}" if keys else "none"
            raise UserError(f"{gait}: joint '{name}' needs one tolerance; it has {what}.")
    return [given[key] for (key,) in found]


def torso_ang_vel_xy_l2(env: Env) -> Tensor:
    """Squared angular velocity of the torso about the horizontal axes of the world, (rad/s)^2."""
    return env.signals.torso_ang_vel_w[:, :2].square().sum(dim=1)


def angular_momentum_l2(env: Env) -> Tensor:
    """Squared angular momentum of the robot about its centre of mass, (kg m^2/s)^2."""
    return env.signals.com_ang_mom_w.square().sum(dim=1)


class StepTime(StatefulTerm):
    """Reward for standing on one leg as long as a step is to take, s.

    It grows with the time since a foot last landed or lifted, the shorter one of the two feet, up to `target`, and
    falls to 0 at twice that time. It is 0 unless exactly one foot is down, and in envs that are commanded to stand.

    Args:
        target: Time at which the reward is highest, s.
        least_command: Size of a command above which it counts, see `size_of_command`.
    """

    def __init__(self, env: Env, target: Positive, least_command: NotNegative = LEAST_COMMAND) -> None:
        self._target, self._least = target, least_command
        self._time = TimeOnOneLeg(env)

    def __call__(self, env: Env) -> Tensor:
        off = (self._time(env) - self._target).abs()
        return (self._target - off).clamp(min=0.0) * (size_of_command(env) > self._least)

    def reset(self, mask: Tensor) -> None:
        """Sets the times of the envs in `mask` to zero."""
        self._time.reset(mask)


def foot_clearance_l1(env: Env, target: NotNegative, least_command: NotNegative = LEAST_COMMAND) -> Tensor:
    """Distance of each sole from a height above the ground, times its horizontal speed, summed, m^2/s.

    The published height is that of the world; here it is over the ground below the sole.

    Args:
        target: Height, m.
        least_command: Size of a command above which it counts, see `size_of_command`.
    """
    speed = env.signals.foot_lin_vel_w[:, :, :2].norm(dim=2)
    cost = ((env.signals.foot_height - target).abs() * speed).sum(dim=1)
    return cost * (size_of_command(env) > least_command)


def slip_l2(env: Env, least_command: NotNegative = LEAST_COMMAND) -> Tensor:
    """Squared horizontal speed of the feet that touch the ground, summed, (m/s)^2; 0 where standing is commanded.

    Args:
        least_command: Size of a command above which it counts, see `size_of_command`.
    """
    return gallant.slip_l2(env) * (size_of_command(env) > least_command)


class LandingForce(StatefulTerm):
    """Ground force on the feet that land in this step, summed, N; 0 where standing is commanded.

    Args:
        least_command: Size of a command above which it counts, see `size_of_command`.
    """

    def __init__(self, env: Env, least_command: NotNegative = LEAST_COMMAND) -> None:
        self._least = least_command
        self._landings = Landings(env)

    def __call__(self, env: Env) -> Tensor:
        force = (env.signals.foot_force * self._landings(env)).sum(dim=1)
        return force * (size_of_command(env) > self._least)

    def reset(self, mask: Tensor) -> None:
        """Forgets the contacts of the envs in `mask`."""
        self._landings.reset(mask)
