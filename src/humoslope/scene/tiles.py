"""Which tile of the terrain each world is on."""

from __future__ import annotations

from functools import cached_property

import torch
from torch import Tensor

from humoslope.terrain.grid import Terrain


class Tiles:
    """The tile of each world: its column (kind of ground) stays, its level (difficulty) may change at a reset.

    Attributes:
        level, column: [N] int64.
        origin_w: [N, 3] start of the tile's centre line, m.
        grade: [N] nominal grade, rad.
        num_levels: Levels there are.
        length, width: Extent of a tile, m.
        spawn_x: Where worlds start, m from the tile's start.
    """

    def __init__(self, terrain: Terrain, num_worlds: int, device: torch.device) -> None:
        self._origins = torch.as_tensor(terrain.tile_origin, dtype=torch.float32, device=device)  # [L, C, 3]
        self._grades = torch.deg2rad(torch.as_tensor(terrain.grade, dtype=torch.float32, device=device))  # [L, C]
        self._terrain = terrain
        self.num_levels, columns = self._grades.shape
        self.length, self.width, self.spawn_x = terrain.tile_length, terrain.tile_width, terrain.spawn_x
        # Worlds are dealt out over the columns evenly, whatever their number.
        self.column = torch.arange(num_worlds, device=device) * columns // num_worlds
        self.kinds = list(terrain.kind)
        self.set_level(torch.zeros(num_worlds, dtype=torch.int64, device=device))

    def set_level(self, level: Tensor) -> None:
        """Puts each world on its column's tile of that level [N]. A world is only moved there at its next reset."""
        self.level = level
        self.origin_w = self._origins[level, self.column]
        self.grade = self._grades[level, self.column]

    @property
    def steepest(self) -> Tensor:
        """Largest inclination on the tile over the length of a stance, [N] rad."""
        return self._steepest[self.level, self.column]

    @cached_property
    def _steepest(self) -> Tensor:
        degrees = torch.as_tensor(self._terrain.steepest, dtype=torch.float32, device=self._grades.device)
        return torch.deg2rad(degrees)  # [L, C]
