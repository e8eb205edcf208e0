"""Tiles of registered terrains laid out by kind and difficulty, as one height field."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from humoslope.errors import UserError
from humoslope.terrain import registry

SPAWN_X = 0.75
"""Where a robot starts, m from the start of its tile."""


@dataclass(frozen=True)
class Terrain:
    """A height field in the world frame; levels lie along world x, the direction of travel, columns along y.

    Attributes:
        heights: [nx, ny] float32, m; the first index runs along x.
        cell: Distance between neighbouring heights, m.
        origin: World x, y of `heights[0, 0]`, m.
        tile_origin: [levels, columns, 3] world position of the start of each tile's centre line, m.
        kind: Name of the terrain in each column.
        grade: [levels, columns] degrees; what each tile was asked for, never signed by up or down.
        tile_length: Extent of a tile along x, m.
        tile_width: Extent of a tile along y, m.
        spawn_x: Where a robot starts, m from the start of its tile.
    """

    heights: NDArray[np.float32]
    cell: float
    origin: tuple[float, float]
    tile_origin: NDArray[np.float64]
    kind: tuple[str, ...]
    grade: NDArray[np.float64]
    tile_length: float
    tile_width: float
    spawn_x: float = SPAWN_X

    @property
    def is_flat(self) -> bool:
        """Whether every height is the same."""
        return bool((self.heights == self.heights[0, 0]).all())


@dataclass(frozen=True)
class TerrainGrid:
    """What a terrain is built from.

    Each tile is drawn on its own and keeps a seam of one cell to its neighbours, in which any step in height lies.

    Attributes:
        columns: Share of the columns that each registered terrain gets. Shares need not sum to one; a share of 0 takes
            a terrain away, any other is worth at least one column.
        levels: Number of difficulties; level i has difficulty i / (levels - 1), and a single level is the easiest.
        num_columns: Number of tiles side by side at each level.
        tile_length: Extent of a tile in the direction of travel, m.
        tile_width: Extent of a tile across, m.
        cell: Distance between neighbouring heights, m; tiles are a whole number of cells.
        border: Width of the flat ground around all tiles, m.
        seed: Of the random numbers; a tile depends only on (seed, column, level).
    """

    columns: Mapping[str, float]
    levels: int = 10
    num_columns: int = 20
    tile_length: float = 10.0
    tile_width: float = 5.0
    cell: float = 0.1
    border: float = 3.0
    seed: int = 0

    def build(self) -> Terrain:
        """Draws every tile; raises `UserError` where a value or a registered function is impossible."""
        self._check()
        kinds = [registry.find(name) for name in self._column_names()]
        x, y = tile_points(self.tile_length, self.tile_width, self.cell)
        # A tile's vertices are its own: the step from its last to the next tile's first is the seam.
        pitch_x, pitch_y = x.shape
        rim = math.ceil(self.border / self.cell - 1e-9)
        shape = (2 * rim + self.levels * pitch_x, 2 * rim + self.num_columns * pitch_y)
        origin = (-0.5 * (shape[0] - 1) * self.cell, -0.5 * (shape[1] - 1) * self.cell)

        heights = np.zeros(shape, dtype=np.float32)
        tile_origin = np.zeros((self.levels, self.num_columns, 3))
        grade = np.zeros((self.levels, self.num_columns))
        for level in range(self.levels):
            for column, kind in enumerate(kinds):
                grade[level, column] = kind.grade_at(level / max(self.levels - 1, 1))
                rng = np.random.default_rng((self.seed, column, level))
                tile = kind.heights(x, y, float(grade[level, column]), rng)
                i, j = rim + level * pitch_x, rim + column * pitch_y
                heights[i : i + pitch_x, j : j + pitch_y] = tile
                tile_origin[level, column, 0] = origin[0] + i * self.cell
                tile_origin[level, column, 1] = origin[1] + (j + 0.5 * (pitch_y - 1)) * self.cell
                # The centre line runs between two vertices where the tile is an odd number of cells wide.
                tile_origin[level, column, 2] = 0.5 * (tile[0, (pitch_y - 1) // 2] + tile[0, pitch_y // 2])
        return Terrain(
            heights=heights,
            cell=self.cell,
            origin=origin,
            tile_origin=tile_origin,
            kind=tuple(kind.name for kind in kinds),
            grade=grade,
            tile_length=self.tile_length,
            tile_width=self.tile_width,
        )

    def _check(self) -> None:
        for field in ("levels", "num_columns"):
            if getattr(self, field) < 1:
                raise UserError(f"terrain grid: {field} is {getattr(self, field)}; it must be at least 1.")
        for field in ("tile_length", "tile_width", "cell"):
            if not 0.0 < getattr(self, field) < math.inf:
                raise UserError(f"terrain grid: {field} is {getattr(self, field)} m; it must be positive.")
            if getattr(self, field) < self.cell:
                raise UserError(f"terrain grid: cell is {self.cell} m, larger than {field}, {getattr(self, field)} m.")
        for field in ("tile_length", "tile_width"):
            extent = getattr(self, field)
            if abs(extent / self.cell - round(extent / self.cell)) > 1e-6:
                raise UserError(f"terrain grid: {field}, {extent} m, must be a whole number of cells of {self.cell} m.")
        if self.tile_length <= SPAWN_X:
            raise UserError(f"terrain grid: tile_length is {self.tile_length} m; robots start at {SPAWN_X} m.")
        if not 0.0 <= self.border < math.inf:
            raise UserError(f"terrain grid: border is {self.border} m; it must be 0 or more.")
        if self.seed < 0:
            raise UserError(f"terrain grid: seed is {self.seed}; it must be 0 or more.")

    def _column_names(self) -> list[str]:
        for name, share in self.columns.items():
            registry.find(name)
            if not 0.0 <= share < math.inf:
                raise UserError(f"terrain grid: the share of '{name}' is {share}; it must be 0 or more.")
        shares = {name: share for name, share in self.columns.items() if share > 0.0}
        if not shares:
            raise UserError("terrain grid: the shares of columns sum to 0; give at least one terrain a share above 0.")
        if len(shares) > self.num_columns:
            raise UserError(f"terrain grid: {len(shares)} terrains do not fit in num_columns={self.num_columns}.")
        total = sum(shares.values())
        count = dict.fromkeys(shares, 1)
        for _ in range(self.num_columns - len(shares)):
            short = max(shares, key=lambda name: shares[name] / total * self.num_columns - count[name])
            count[short] += 1
        return [name for name in shares for _ in range(count[name])]


def tile_points(length: float, width: float, cell: float) -> tuple[registry.Array, registry.Array]:
    """Where a tile's heights are: x from 0 to length and y from -width/2 to width/2, each [nx, ny], m."""
    x = np.arange(round(length / cell) + 1) * cell
    y = np.arange(round(width / cell) + 1) * cell - 0.5 * width
    grid_x, grid_y = np.meshgrid(x, y, indexing="ij")
    return grid_x, grid_y
