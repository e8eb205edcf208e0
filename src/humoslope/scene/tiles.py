"""Assignment of the envs to the tiles of the terrain."""

from __future__ import annotations

import torch
from torch import Tensor

from humoslope.terrain.grid import Terrain


class Tiles:
    """Tile of each env: its column (kind of ground) is fixed, its level (difficulty) may change at a reset.

    Isaac Lab calls them `terrain_types` and `terrain_levels`.

    Attributes:
        level: [N] int64, difficulty of the tile.
        column: [N] int64, column of tiles, each with one kind of ground.
        origin_w: [N, 3] start of the tile's centre line, m.
        grade: [N] nominal grade, rad.
        num_levels: Number of levels.
        length: Extent of a tile along x, m.
        width: Extent of a tile along y, m.
        spawn_x: Distance of the spawn place from the tile's start, m.
        omnidirectional: [N] bool, True where the tile is walked in any direction from any place, False where it is
            walked from its start along x.
        has_omnidirectional, has_straight: True if any column of the terrain is of the one and of the other sort.
    """

    def __init__(self, terrain: Terrain, num_envs: int, device: torch.device) -> None:
        self._origins = torch.as_tensor(terrain.tile_origin, dtype=torch.float32, device=device)  # [L, C, 3]
        self._grades = torch.deg2rad(torch.as_tensor(terrain.grade, dtype=torch.float32, device=device))  # [L, C]
        self._steepest = torch.deg2rad(torch.as_tensor(terrain.steepest, dtype=torch.float32, device=device))  # [L, C]
        self.num_levels, columns = self._grades.shape
        self.length, self.width, self.spawn_x = terrain.tile_length, terrain.tile_width, terrain.spawn_x
        # Spreads the envs evenly over the columns, whatever their number.
        self.column = torch.arange(num_envs, device=device) * columns // num_envs
        corners = [[0.0, -0.5 * self.width], [self.length, 0.5 * self.width]]
        self._low, self._high = torch.tensor(corners, device=device)[..., None, None]  # [2, 1, 1] m from the start
        free = [column in terrain.omnidirectional for column in range(columns)]
        self.has_omnidirectional, self.has_straight = any(free), not all(free)
        self.omnidirectional = torch.tensor(free, device=device)[self.column]
        self.set_level(torch.zeros(num_envs, dtype=torch.int64, device=device))

    def set_level(self, level: Tensor) -> None:
        """Assigns each env the tile of that level [N] in its column. Its robot moves there at its next reset."""
        self.level = level
        self.origin_w = self._origins[level, self.column]
        self.grade = self._grades[level, self.column]

    def nearest(self, places: Tensor, rows: Tensor | slice = slice(None)) -> Tensor:
        """The points of the envs' own tiles that are nearest to `places` [2, n, P] (all x, then all y, m).

        Args:
            rows: The n envs.
        """
        start = self.origin_w[rows, :2].T[:, :, None]  # [2, n, 1]
        return torch.minimum(torch.maximum(places, start + self._low), start + self._high)

    @property
    def steepest(self) -> Tensor:
        """Largest inclination on the tile over the length of a stance, [N] rad."""
        return self._steepest[self.level, self.column]
