"""Heights and normals of the ground under any point, on the triangles that MuJoCo collides with."""

from __future__ import annotations

import torch
from torch import Tensor

from humoslope.terrain.grid import Terrain


class TerrainQueries:
    """Batched lookups on a terrain; nothing waits for the device.

    MuJoCo splits every cell along the diagonal from the corner low in x and y to the one high in both. With hi and lo
    the larger and the smaller fraction of the cell crossed in x and y, and m the corner on the point's side of it,
    h = h00 + hi (m - h00) + lo (h11 - m).

    Points beyond the field read the height at its edge; a NaN coordinate gives NaN.
    """

    def __init__(self, terrain: Terrain, device: torch.device | str) -> None:
        self.cell = terrain.cell
        self._rows, self._cols = terrain.heights.shape
        self._heights = torch.as_tensor(terrain.heights, device=device).flatten()
        # u = x / cell + shift is the place in units of cells; an edge is the largest place in the field.
        self._shift = (-terrain.origin[0] / terrain.cell, -terrain.origin[1] / terrain.cell)
        self._edge = (float(self._rows - 1), float(self._cols - 1))

    def height(self, xy: Tensor) -> Tensor:
        """Height of the ground, m, shape [...], at world points xy [..., 2]."""
        return self._height(xy[..., 0], xy[..., 1])

    def normal(self, xy: Tensor) -> Tensor:
        """Unit normal of the triangle at world points xy [..., 2], shape [..., 3], world frame."""
        _, _, along_x, low, mid, high = self._triangle(xy[..., 0], xy[..., 1])
        first, second = low - mid, mid - high  # minus the rise along the first and the second axis crossed
        normal = torch.stack(
            (
                torch.where(along_x, first, second),
                torch.where(along_x, second, first),
                torch.full_like(first, self.cell),
            ),
            dim=-1,
        )
        return torch.nn.functional.normalize(normal, dim=-1)

    def slope_normal(self, xy: Tensor, radius: float = 0.4) -> Tensor:
        """Unit normal of the slope as a robot's stance feels it, shape [..., 3], world frame.

        Taken from the heights `radius` metres to each side of xy [..., 2] in x and y, which evens out smaller bumps.
        """
        x, y = xy[..., 0], xy[..., 1]
        around = self._height(
            torch.stack((x - radius, x + radius, x, x), dim=-1), torch.stack((y, y, y - radius, y + radius), dim=-1)
        )
        normal = torch.stack(
            (
                around[..., 0] - around[..., 1],
                around[..., 2] - around[..., 3],
                torch.full_like(x, 2.0 * radius),
            ),
            dim=-1,
        )
        return torch.nn.functional.normalize(normal, dim=-1)

    def _height(self, x: Tensor, y: Tensor) -> Tensor:
        fx, fy, _, low, mid, high = self._triangle(x, y)
        return low + torch.maximum(fx, fy) * (mid - low) + torch.minimum(fx, fy) * (high - mid)

    def _triangle(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Fractions of the cell in x and y, whether x is crossed further, and the heights at the triangle's corners."""
        u = (x / self.cell).add_(self._shift[0]).clamp_(0.0, self._edge[0])
        v = (y / self.cell).add_(self._shift[1]).clamp_(0.0, self._edge[1])
        # Clamped once more as integers: NaN passes the first clamp, and must not read outside the table.
        i = u.to(torch.int32).clamp_(0, self._rows - 2)
        j = v.to(torch.int32).clamp_(0, self._cols - 2)
        fx, fy = u.sub_(i), v.sub_(j)
        along_x = fx >= fy
        corner = i.mul_(self._cols).add_(j)
        middle = torch.where(along_x, self._cols, 1).to(torch.int32).add_(corner)
        index = torch.stack((corner, middle, corner + (self._cols + 1)))
        low, mid, high = self._heights.index_select(0, index.flatten()).view(index.shape)
        return fx, fy, along_x, low, mid, high
