"""Rotations as unit quaternions (w, x, y, z), batched over leading dimensions."""

from __future__ import annotations

from functools import lru_cache

import torch
from torch import Tensor


@lru_cache(maxsize=8)
def _expansion(dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """[9, 16] and [9]: the rotation matrix from the products of all pairs of w, x, y, z, and its constant part."""
    products = 2.0 * torch.eye(16, dtype=dtype, device=device).view(4, 4, 16)
    w, x, y, z = range(4)
    rows = (
        (-products[y, y] - products[z, z], products[x, y] - products[w, z], products[x, z] + products[w, y]),
        (products[x, y] + products[w, z], -products[x, x] - products[z, z], products[y, z] - products[w, x]),
        (products[x, z] - products[w, y], products[y, z] + products[w, x], -products[x, x] - products[y, y]),
    )
    entries = [entry for row in rows for entry in row]
    return torch.stack(entries), torch.eye(3, dtype=dtype, device=device).flatten()


def matrix(q: Tensor) -> Tensor:
    """The rotation matrix [..., 3, 3] of `q` [..., 4]: body frame to world frame."""
    products = q.unsqueeze(-1) * q.unsqueeze(-2)
    return torch.nn.functional.linear(products.flatten(-2), *_expansion(q.dtype, q.device)).unflatten(-1, (3, 3))


def rotate(q: Tensor, v: Tensor) -> Tensor:
    """Rotates vectors `v` [..., 3] by `q` [..., 4]: body frame to world frame."""
    return (matrix(q) @ v.unsqueeze(-1)).squeeze(-1)


def from_yaw(angle: Tensor) -> Tensor:
    """The quaternion [..., 4] of a turn by `angle` [...] about the vertical."""
    half = 0.5 * angle
    zero = torch.zeros_like(angle)
    return torch.stack([half.cos(), zero, zero, half.sin()], dim=-1)


def from_rotation_vector(v: Tensor) -> Tensor:
    """The quaternion [..., 4] of a turn about `v` [..., 3] by its length, rad."""
    half = 0.5 * v.norm(dim=-1, keepdim=True)
    return torch.cat([half.cos(), 0.5 * torch.sinc(half / torch.pi) * v], dim=-1)
