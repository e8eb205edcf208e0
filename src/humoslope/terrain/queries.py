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
        rows, self._cols = terrain.heights.shape
        self._heights = torch.as_tensor(terrain.heights, device=device).flatten()
        # x / cell + shift is the place in units of cells.
        shift = [[-axis / terrain.cell] for axis in terrain.origin]
        self._shift = torch.tensor(shift, dtype=torch.float32, device=device)  # [2, 1]
        edge = torch.tensor([[rows - 1.0], [self._cols - 1.0]], device=device)
        self._places = torch.zeros_like(edge), edge  # first and last place, [2, 1] each
        self._cells = torch.zeros_like(edge, dtype=torch.int32), (edge - 1.0).to(torch.int32)
        # From the corner low in x and y to the middle one, if x or if y is crossed further, in the flat table.
        self._next_row, self._next_column = torch.tensor([self._cols, 1], dtype=torch.int32, device=device)
        self._sides = torch.tensor([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]], device=device)

    def height(self, xy: Tensor) -> Tensor:
        """Height of the ground, m, shape [...], at world points xy [..., 2]."""
        return self._height(_axes_first(xy)).view(xy.shape[:-1])

    def normal(self, xy: Tensor) -> Tensor:
        """Unit normal of the triangle at world points xy [..., 2], shape [..., 3], world frame."""
        _, along_x, (low, mid, high) = self._triangle(_axes_first(xy))
        first, second = low - mid, mid - high  # minus the rise along the first and the second axis crossed
        slope = torch.stack((torch.where(along_x, first, second), torch.where(along_x, second, first)), dim=-1)
        return _upward(slope.view(xy.shape), self.cell)

    def around(self, xy: Tensor, radius: float = 0.4) -> Tensor:
        """The points [..., 4, 2] whose heights `slope_normal` needs: `radius` m to each side of xy [..., 2]."""
        return xy.unsqueeze(-2) + radius * self._sides

    def slope_normal(self, heights: Tensor, radius: float = 0.4) -> Tensor:
        """Unit normal of the slope as a robot's stance feels it, shape [..., 3], world frame.

        Taken from the heights [..., 4] `around` a point, which evens out smaller bumps.
        """
        return _upward(heights[..., 0::2] - heights[..., 1::2], 2.0 * radius)

    def _height(self, xy: Tensor) -> Tensor:
        fraction, _, (low, mid, high) = self._triangle(xy)
        inner = torch.addcmul(low, torch.maximum(*fraction), mid - low)
        return inner.addcmul_(torch.minimum(*fraction), high - mid)

    def _triangle(self, xy: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Fractions [2, M] of the cell at xy [2, M], whether x is crossed further [M], and the heights [3, M] at the
        triangle's corners."""
        place = xy.div(self.cell).add_(self._shift).clamp_(*self._places)
        # Clamped once more as integers: NaN passes the first clamp, and must not read outside the table.
        cell = place.to(torch.int32).clamp_(*self._cells)
        fraction = place.sub_(cell)
        along_x = fraction[0] >= fraction[1]
        low = torch.add(cell[1], cell[0], alpha=self._cols)
        mid = torch.where(along_x, self._next_row, self._next_column).add_(low)
        corners = torch.stack((low, mid, low + (self._cols + 1)))
        return fraction, along_x, self._heights.index_select(0, corners.flatten()).view(corners.shape)


def _axes_first(xy: Tensor) -> Tensor:
    """Points [..., 2] as [2, M]: what is done to each axis runs over memory without gaps."""
    return xy.reshape(-1, 2).t().contiguous()


def _upward(fall: Tensor, length: float) -> Tensor:
    """Unit normal [..., 3] of ground that falls by `fall` [..., 2] m along x and y over `length` m."""
    normal = torch.nn.functional.pad(fall, (0, 1), value=length)
    return normal / normal.norm(dim=-1, keepdim=True)
