"""Heights and normals of the ground under any point, on the triangles that MuJoCo collides with."""

from __future__ import annotations

import torch
from torch import Tensor

from humoslope.terrain.grid import Terrain


class TerrainQueries:
    """Batched lookups on a terrain; nothing waits for the device.

    MuJoCo splits every cell along the diagonal from the corner low in x and y to the one high in both. A table holds
    the plane of each triangle: the height of that low corner, and the rise over a cell along x and along y.

    Points beyond the field read the height at its edge; a NaN coordinate gives NaN.
    """

    def __init__(self, terrain: Terrain, device: torch.device | str) -> None:
        self.cell = terrain.cell
        rows, self._cols = terrain.heights.shape
        # x / cell + shift is the place in units of cells.
        shift = [[-axis / terrain.cell] for axis in terrain.origin]
        self._shift = torch.tensor(shift, dtype=torch.float32, device=device)  # [2, 1]
        edge = torch.tensor([[rows - 1.0], [self._cols - 1.0]], device=device)
        self._low, self._high = torch.zeros_like(edge), edge  # [2, 1] first and last place
        self._planes = _planes(torch.as_tensor(terrain.heights, device=device))  # [2 R C, 3]
        self._sides = torch.tensor([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]], device=device)

    def height(self, xy: Tensor) -> Tensor:
        """Height of the ground, m, shape [...], at world points xy [..., 2]."""
        return self._height(_axes_first(xy)).view(xy.shape[:-1])

    def around(self, xy: Tensor, radius: float = 0.4) -> Tensor:
        """The points [..., 4, 2] whose heights `slope_normal` needs: `radius` m to each side of xy [..., 2]."""
        return xy.unsqueeze(-2) + radius * self._sides

    def slope_normal(self, heights: Tensor, radius: float = 0.4) -> Tensor:
        """Unit normal of the slope at the scale of a step, shape [..., 3], world frame.

        It is taken from the heights [..., 4] at the points `around` a place, which evens out smaller bumps.
        """
        return _upward(heights[..., 0::2] - heights[..., 1::2], 2.0 * radius)

    def _height(self, xy: Tensor) -> Tensor:
        fraction, plane = self._plane(xy)
        corner, along_x, along_y = plane.unbind(dim=1)
        return corner.addcmul(fraction[0], along_x).addcmul_(fraction[1], along_y)

    def _plane(self, xy: Tensor) -> tuple[Tensor, Tensor]:
        """Place within its cell of each point xy [2, M], as shares [2, M], and the plane there [M, 3]."""
        place = torch.add(self._shift, xy, alpha=1.0 / self.cell)
        # On the CPU several times as fast as `torch.clamp`, whose bounds would be tensors.
        place = torch.minimum(torch.maximum(place, self._low), self._high)
        cell = place.to(torch.int32)
        fraction = place.sub_(cell)
        index = torch.add(cell[1], cell[0], alpha=self._cols)
        index = torch.add(fraction[0] >= fraction[1], index, alpha=2)
        # NaN passes the first clamp, and must not read outside the table.
        return fraction, self._planes.index_select(0, index.clamp_(0, len(self._planes) - 1))


def _planes(heights: Tensor) -> Tensor:
    """The triangles of a height field [R, C], [2 R C, 3]: cell by cell the one along y, then the one along x.

    Of the cells that begin at its last row or column, which no point enters, only the corner counts; their slopes are
    those of the cells before them.
    """
    along_x, along_y = heights.diff(dim=0), heights.diff(dim=1)
    planes = heights.new_empty(*heights.shape, 2, 3)  # [R, C, triangle, corner and rises]
    planes[..., 0] = heights[:, :, None]
    cells = planes[:-1, :-1]
    cells[..., 0, 1], cells[..., 0, 2] = along_x[:, 1:], along_y[:-1]
    cells[..., 1, 1], cells[..., 1, 2] = along_x[:, :-1], along_y[1:]
    planes[-1, ..., 1:] = planes[-2, ..., 1:]
    planes[:, -1, :, 1:] = planes[:, -2, :, 1:]
    return planes.view(-1, 3)


def _axes_first(xy: Tensor) -> Tensor:
    """Points [..., 2] as [2, M], so that operations on one axis run over contiguous memory."""
    return xy.reshape(-1, 2).t().contiguous()


def _upward(fall: Tensor, length: float) -> Tensor:
    """Unit normal [..., 3] of ground that falls by `fall` [..., 2] m along x and y over `length` m."""
    normal = torch.nn.functional.pad(fall, (0, 1), value=length)
    return normal / normal.norm(dim=-1, keepdim=True)
