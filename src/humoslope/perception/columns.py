"""The ground in a box that moves with a body: its height in every column of the box, along the body's own up axis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from humoslope.errors import UserError

STEEPEST_COLUMN = 0.2
"""Least vertical share of a column's direction: the columns of a body that has all but fallen over are taken for less
inclined than they are (78 degrees), so that heights stay finite."""


@dataclass(frozen=True)
class ColumnGrid:
    """Columns of cubic cells in a box around a body, in the body's frame.

    Attributes:
        length: Extent of the box forward and back together, and to both sides together, m.
        low, high: Lower and upper end of the box, m.
        cell: Edge of a cell, m.

    Raises:
        UserError: If the cell does not divide the box.
    """

    length: float
    low: float
    high: float
    cell: float

    def __post_init__(self) -> None:
        for extent in (self.length, self.high - self.low):
            if not 0.0 < self.cell <= extent or abs(extent / self.cell - round(extent / self.cell)) > 1e-6:
                raise UserError(f"a voxel grid's cell of {self.cell:g} m must divide its box of {extent:g} m.")

    @property
    def side(self) -> int:
        """Number of columns along each horizontal axis."""
        return round(self.length / self.cell)

    @property
    def levels(self) -> int:
        """Number of cells in a column."""
        return round((self.high - self.low) / self.cell)

    @property
    def empty(self) -> float:
        """Height that stands for a column in which nothing was seen, m; well below the box."""
        return self.low - 1.0

    def offsets(self, device: torch.device) -> Tensor:
        """Centres of the columns, forward and to the left, [2, P] m: row by row from the rear, each from the right."""
        axis = (torch.arange(self.side, device=device) - 0.5 * (self.side - 1)) * self.cell
        return torch.cartesian_prod(axis, axis).T.contiguous()

    def __str__(self) -> str:
        """Its size in words, such as "16 x 16 x 20 of 10 cm"."""
        return f"{self.side} x {self.side} x {self.levels} of {100.0 * self.cell:g} cm"


def column_heights(
    position: Tensor,
    rotation: Tensor,
    offsets: Tensor,
    ground: Tensor,
    normal: Tensor,
    height: Callable[[Tensor], Tensor],
    steps: int = 3,
) -> Tensor:
    """Height of the ground in every column of a box, in the frame of the body that carries it.

    The ground in a column is where the line along the body's up axis meets the field of heights. It is looked for from
    where the line meets the plane below the body, on by fixed-point steps: the height below the last guess is the next
    one. A step shrinks an error by the product of the ground's slope and the tangent of the body's tilt, e.g. to 15 %
    at 30 degrees each; a plane is met at once. A field of heights has one ground in every column, so nothing hides
    behind anything else and the robot does not see itself.

    Args:
        position: [n, 3] of the body, world frame, m.
        rotation: [n, 3, 3] of the body, body frame to world frame.
        offsets: [2, P] places of the columns, forward and to the left in the body's frame, m.
        ground: [n] height of the ground below the body, m.
        normal: [n, 3] unit normal of the plane from which the search begins.
        height: Heights of the ground [n, P], m, at places [2, n, P], x and y, m.
        steps: Fixed-point steps, a lookup of P heights each.

    Returns:
        [n, P] heights along the body's up axis, m; negative below the body's origin.
    """
    up = rotation[:, :, 2]  # [n, 3]
    vertical = up[:, 2:].clamp(min=STEEPEST_COLUMN)  # [n, 1]
    # Where the columns pass through the body's horizontal plane, x, y and z each in one piece.
    feet = torch.matmul(rotation[:, :, :2], offsets) + position[:, :, None]  # [n, 3, P]
    x, y, z = feet.unbind(dim=1)
    below = torch.cat([position[:, :2], ground[:, None]], dim=1)
    rise = (normal[:, :, None] * (below[:, :, None] - feet)).sum(dim=1)  # [n, P] along the normal
    along = rise / (normal * up).sum(dim=1, keepdim=True).clamp(min=STEEPEST_COLUMN)
    for _ in range(steps):
        places = torch.stack([torch.addcmul(x, along, up[:, :1]), torch.addcmul(y, along, up[:, 1:2])])
        along = (height(places) - z) / vertical
    return along
