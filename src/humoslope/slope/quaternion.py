"""Rotations as unit quaternions (w, x, y, z), batched over leading dimensions."""

from __future__ import annotations

import torch
from torch import Tensor


def rotate(q: Tensor, v: Tensor) -> Tensor:
    """Rotates vectors `v` [..., 3] by `q` [..., 4]: body frame to world frame."""
    w, u = q[..., :1], q[..., 1:]
    t = 2.0 * torch.linalg.cross(u, v)
    return v + w * t + torch.linalg.cross(u, t)


def rotate_inverse(q: Tensor, v: Tensor) -> Tensor:
    """Rotates vectors `v` [..., 3] by the inverse of `q` [..., 4]: world frame to body frame."""
    w, u = q[..., :1], q[..., 1:]
    t = 2.0 * torch.linalg.cross(u, v)
    return v - w * t + torch.linalg.cross(u, t)


def up_in_body(q: Tensor) -> Tensor:
    """The world's vertical seen from the body, [..., 3]: the last row of the rotation matrix of `q` [..., 4]."""
    w, x, y, z = q.unbind(-1)
    return torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], dim=-1)


def yaw(q: Tensor) -> Tensor:
    """Heading of the body's x axis in the horizontal plane, rad, [...]."""
    w, x, y, z = q.unbind(-1)
    return torch.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def from_yaw(angle: Tensor) -> Tensor:
    """The quaternion [..., 4] of a turn by `angle` [...] about the vertical."""
    half = 0.5 * angle
    zero = torch.zeros_like(angle)
    return torch.stack([half.cos(), zero, zero, half.sin()], dim=-1)
