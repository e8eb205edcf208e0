"""Rewards for standing still. They act in envs that are commanded to stand and are 0 in all others; [N] each.

Together they ask for what a robot that stands does on any ground it can stand on: both feet down, no step, no creep,
and a posture close to the default one. Speeds and contacts are those of the feet on their ground, so nothing here
depends on the slope, except `posture_l1`, whose pattern should leave the ankles free.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from torch import Tensor

from humoslope.mdp import rewards
from humoslope.mdp.selection import Joints

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


def standing(env: Env) -> Tensor:
    """Mask of the envs that are commanded to stand, [N] bool: the gate of every term here."""
    return ~env.commands.moving


def both_feet_down(env: Env) -> Tensor:
    """1 while both feet touch the ground, else 0."""
    return (env.signals.foot_contact.all(dim=1) & standing(env)).float()


def foot_speed(env: Env) -> Tensor:
    """Speed of both feet, on the ground or in the air, summed, m/s: a step and a slide cost alike."""
    return env.signals.foot_lin_vel_w.norm(dim=2).sum(dim=1) * standing(env)


def creep(env: Env) -> Tensor:
    """Speed of the root along the ground, m/s.

    Linear, so that a slow creep, of which the square would be next to nothing, still costs.
    """
    return env.signals.root_lin_vel_t[:, :2].norm(dim=1) * standing(env)


def joint_vel_l2(env: Env) -> Tensor:
    """Squared joint velocities, summed, (rad/s)^2."""
    return env.signals.joint_vel.square().sum(dim=1) * standing(env)


def posture_l1(env: Env, joints: Joints = ".*(hip|knee|waist|shoulder|elbow|wrist).*") -> Tensor:
    """Distance of the joints from the default pose, summed, rad.

    Args:
        joints: Regular expression on whole joint names. By default all but the ankles, which follow the slope.
    """
    return rewards.joint_deviation_l1(env, joints) * standing(env)
