"""Slope-adaptive zero-moment-point deviation of the paper's section 3.1, as pure functions.

All points and vectors are [..., 3] in the world frame, in metres, m/s^2 and newtons.
"""

from __future__ import annotations

import torch
from torch import Tensor

GRAVITY = 9.81
"""Acceleration of gravity, m/s^2, as in MuJoCo's default."""


def support_anchor(foot_pos: Tensor, foot_force: Tensor, epsilon: float) -> Tensor:
    """Support anchor p_sa: the feet's positions weighted by their contact forces.

    Args:
        foot_pos: [..., 2, 3] left and right sole centre.
        foot_force: [..., 2] magnitude of the contact force on each foot, N.
        epsilon: Force added to both, N; in flight the anchor is the midpoint.

    Returns:
        [..., 3].
    """
    load = (foot_force + epsilon).unsqueeze(-1)
    return (load * foot_pos).sum(dim=-2) / load.sum(dim=-2)


def dominant_normal(foot_normal: Tensor, foot_force: Tensor) -> Tensor:
    """Support-plane normal n_c: the sole's up axis of the foot that carries more.

    Args:
        foot_normal: [..., 2, 3] unit vectors.
        foot_force: [..., 2] N.

    Returns:
        [..., 3].
    """
    left = foot_force[..., :1] >= foot_force[..., 1:]
    return torch.where(left, foot_normal[..., 0, :], foot_normal[..., 1, :])


def apparent_force(com_acc: Tensor) -> Tensor:
    """Apparent specific force F_app = g - a_com, [..., 3] m/s^2."""
    apparent = -com_acc
    apparent[..., 2] -= GRAVITY
    return apparent


def zmp_on_plane(com: Tensor, apparent: Tensor, anchor: Tensor, normal: Tensor) -> Tensor:
    """Intersection of the apparent-force ray through the CoM with the support plane, [..., 3].

    The ray must not be parallel to the plane; see `presses_on_plane`.
    """
    t = ((anchor - com) * normal).sum(-1, keepdim=True) / (apparent * normal).sum(-1, keepdim=True)
    return com + t * apparent


def presses_on_plane(apparent: Tensor, normal: Tensor, least: float) -> Tensor:
    """True where the apparent force presses into the plane with at least `least` m/s^2, [...] bool.

    Near-parallel rays meet the plane far away, and in free fall there is no zero-moment point.
    """
    return (apparent * normal).sum(-1) <= -least


def zero_moment_point(
    com: Tensor, com_acc: Tensor, anchor: Tensor, normal: Tensor, least: float
) -> tuple[Tensor, Tensor]:
    """Zero-moment point on the support plane, and a mask of where it is defined.

    Args:
        com: Whole-body centre of mass.
        com_acc: Its acceleration, m/s^2.
        anchor: Support anchor.
        normal: Unit normal of the support plane.
        least: Smallest pressure of the apparent force on the plane, m/s^2.

    Returns:
        Point [..., 3] (the anchor where it is undefined), and a bool mask [...].
    """
    apparent = apparent_force(com_acc)
    valid = presses_on_plane(apparent, normal, least)
    there = valid.unsqueeze(-1)
    # Where it is undefined a harmless ray is used, so that no infinity arises that a mask could not remove.
    safe = torch.where(there, apparent, -GRAVITY * normal)
    return torch.where(there, zmp_on_plane(com, safe, anchor, normal), anchor), valid
