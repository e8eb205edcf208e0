"""Five-dimensional PCA terrain descriptor of the paper's section 3.2, as pure functions."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

LEAST_SPREAD = 0.01
"""Least product of two differences: those between the variances along the two long axes of the points and the variance
along the third, as shares of the whole variance. Points ten times as long as wide are about there; below it they count
as a line, about which a plane could turn. Ours."""

STEEPEST = math.radians(80.0)
"""Inclination from which a plane does not count as ground, rad. Ours."""


class Descriptor(NamedTuple):
    """Orientation of the ground around a robot, in the robot's heading frame.

    Attributes:
        normal: [..., 3] unit normal (forward, left, up); the up component is positive.
        slope: [...] rad, positive where the ground rises ahead.
        bank: [...] rad, positive where the ground rises to the left.
        up, down: [...] bool, slope beyond the dead band.
        valid: [...] bool; False where the points have no plane, and everything else is that of level ground.
    """

    normal: Tensor
    slope: Tensor
    bank: Tensor
    up: Tensor
    down: Tensor
    valid: Tensor


def terrain_descriptor(points: Tensor, valid: Tensor, dead_band: float) -> Descriptor:
    """Descriptor of the plane that lies closest to the points, by principal component analysis.

    The plane goes through the points' mean, so that their absolute height does not matter. Its normal is the direction
    in which they vary least: distances are taken along it (total least squares), not along the vertical.

    Args:
        points: [..., P, 3] forward, left and height in the robot's heading frame, m.
        valid: [..., P] bool; the other points are ignored, even if they are NaN.
        dead_band: Slope up to which the ground counts as level, rad.
    """
    here = valid.unsqueeze(-2)
    known = torch.where(here, points.mT, 0.0)  # [..., 3, P]
    weight = here.to(points.dtype)
    centre = known.sum(dim=-1, keepdim=True) / weight.sum(dim=-1, keepdim=True).clamp(min=1.0)
    # Squared only after the mean is off: ground at 100 m would leave nothing of a float32's digits.
    centred = torch.addcmul(known, weight, centre, value=-1.0)
    normal, found = _least_direction(centred @ centred.mT)
    level = torch.zeros_like(normal)
    level[..., 2] = 1.0
    normal = torch.where(found.unsqueeze(-1), normal, level)
    forward, left, up = normal.unbind(dim=-1)
    slope = torch.atan2(-forward, up)
    return Descriptor(
        normal=normal,
        slope=slope,
        bank=torch.atan2(-left, up),
        up=slope > dead_band,
        down=slope < -dead_band,
        valid=found,
    )


def phi5(descriptor: Descriptor) -> Tensor:
    """Descriptor as the critic observes it (paper, section 3.2): slope, bank, |slope|, 1_up, 1_down, [..., 5]."""
    d = descriptor
    return torch.stack((d.slope, d.bank, d.slope.abs(), d.up.to(d.slope.dtype), d.down.to(d.slope.dtype)), dim=-1)


def _least_direction(scatter: Tensor) -> tuple[Tensor, Tensor]:
    """Unit eigenvector of the smallest eigenvalue of symmetric, positive semi-definite matrices [..., 3, 3].

    Closed form: with the trace scaled to 1, D = C - I/3 has the eigenvalues 2 p cos(phi + 2 k pi/3), where
    p = |D| / sqrt(6) and cos(3 phi) = det(D) / (2 p^3); the smallest is mu, with k = 1 (Smith 1961, Communications of
    the ACM 4(4):168). The adjugate of D - mu I is g n n^T, with n the eigenvector and g the product of the differences
    between mu and the other two. Its last row, g n_z n, points up, and is good unless n is level. D has no trace, so
    that this row is D_x x D_y + mu D_z + mu^2 e_z, and g is 3 (mu^2 - p^2).

    phi is ill-conditioned where two eigenvalues coincide. If they are the larger two, as on a square patch of a level
    plane, mu has its extreme in phi there and loses nothing. If they are the smaller two, no direction is the least.

    Returns:
        Direction [..., 3] with its last component positive, and whether there is only one and it is not level,
        [...] bool: False for a matrix of zeros or NaN. Where False, the direction is anything, even NaN.
    """
    trace = scatter.diagonal(dim1=-2, dim2=-1).sum(dim=-1)
    deviator = scatter / trace[..., None, None]
    deviator.diagonal(dim1=-2, dim2=-1).sub_(1.0 / 3.0)
    p = torch.linalg.vector_norm(deviator, dim=(-2, -1)) / math.sqrt(6.0)
    x, y, z = deviator.unbind(dim=-2)
    cross = torch.linalg.cross(x, y)
    phi = ((cross * z).sum(dim=-1) / (2.0 * p**3)).clamp(-1.0, 1.0).acos() / 3.0
    mu = 2.0 * p * torch.cos(phi + 2.0 * math.pi / 3.0)
    row = torch.addcmul(cross, mu.unsqueeze(-1), z)
    row[..., 2] += mu**2
    g = 3.0 * (mu**2 - p**2)
    # Before the row is normalised: that of a level eigenvector holds nothing but rounding, which may point anywhere.
    steep = row[..., 2] <= math.cos(STEEPEST) ** 2 * g
    return torch.nn.functional.normalize(row, dim=-1), (g > LEAST_SPREAD) & ~steep
