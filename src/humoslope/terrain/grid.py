"""Tiles of registered terrains laid out by kind and difficulty, as one height field."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

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
class TerrainGridCfg:
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
        difficulties = [level / max(self.levels - 1, 1) for level in range(self.levels)]
        return _lay_out(self, [[Tile(kind, kind.grade_at(d)) for kind in kinds] for d in difficulties])

    def _check(self) -> None:
        for field in ("levels", "num_columns"):
            if getattr(self, field) < 1:
                raise UserError(f"terrain grid: {field} is {getattr(self, field)}; it must be at least 1.")
        _check_extents(self)

    def _column_names(self) -> list[str]:
        for name, share in self.columns.items():
            if not registry.find(name).training:
                raise UserError(f"terrain grid: '{name}' is what policies are measured on; they must not train on it.")
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


class Tile(NamedTuple):
    """A terrain at a grade in degrees."""

    kind: registry.Kind
    grade: float


@dataclass(frozen=True)
class TileRowCfg:
    """Tiles side by side, each asked for by itself: what a measurement walks on. Its terrains need not be registered.

    Attributes:
        tiles: One for each column of the only level.
        tile_length, tile_width, cell, border, seed: As in `TerrainGridCfg`.
    """

    tiles: Sequence[Tile]
    tile_length: float = 10.0
    tile_width: float = 5.0
    cell: float = 0.1
    border: float = 3.0
    seed: int = 0

    def build(self) -> Terrain:
        """Draws every tile; raises `UserError` where a value or a terrain's function is impossible."""
        if not self.tiles:
            raise UserError("terrain: a row has no tiles; give it at least one.")
        _check_extents(self)
        return _lay_out(self, [self.tiles])


def _check_extents(layout: TerrainGridCfg | TileRowCfg) -> None:
    for field in ("tile_length", "tile_width", "cell"):
        if not 0.0 < getattr(layout, field) < math.inf:
            raise UserError(f"terrain: {field} is {getattr(layout, field)} m; it must be positive.")
        if getattr(layout, field) < layout.cell:
            raise UserError(f"terrain: cell is {layout.cell} m, larger than {field}, {getattr(layout, field)} m.")
    for field in ("tile_length", "tile_width"):
        extent = getattr(layout, field)
        if abs(extent / layout.cell - round(extent / layout.cell)) > 1e-6:
            raise UserError(f"terrain: {field}, {extent} m, must be a whole number of cells of {layout.cell} m.")
    if layout.tile_length <= SPAWN_X:
        raise UserError(f"terrain: tile_length is {layout.tile_length} m; robots start at {SPAWN_X} m.")
    if not 0.0 <= layout.border < math.inf:
        raise UserError(f"terrain: border is {layout.border} m; it must be 0 or more.")
    if layout.seed < 0:
        raise UserError(f"terrain: seed is {layout.seed}; it must be 0 or more.")


def _lay_out(layout: TerrainGridCfg | TileRowCfg, tiles: Sequence[Sequence[Tile]]) -> Terrain:
    """Draws `tiles` [levels][columns] into one height field."""
    cell, levels, columns = layout.cell, len(tiles), len(tiles[0])
    x, y = tile_points(layout.tile_length, layout.tile_width, cell)
    # A tile's vertices are its own: the step from its last to the next tile's first is the seam.
    pitch_x, pitch_y = x.shape
    rim = math.ceil(layout.border / cell - 1e-9)
    shape = (2 * rim + levels * pitch_x, 2 * rim + columns * pitch_y)
    origin = (-0.5 * (shape[0] - 1) * cell, -0.5 * (shape[1] - 1) * cell)

    heights = np.zeros(shape, dtype=np.float32)
    tile_origin = np.zeros((levels, columns, 3))
    grade = np.zeros((levels, columns))
    for level, row in enumerate(tiles):
        for column, tile in enumerate(row):
            rng = np.random.default_rng((layout.seed, column, level))
            drawn = tile.kind.heights(x, y, tile.grade, rng)
            i, j = rim + level * pitch_x, rim + column * pitch_y
            heights[i : i + pitch_x, j : j + pitch_y] = drawn
            tile_origin[level, column, 0] = origin[0] + i * cell
            tile_origin[level, column, 1] = origin[1] + (j + 0.5 * (pitch_y - 1)) * cell
            # The centre line runs between two vertices where the tile is an odd number of cells wide.
            tile_origin[level, column, 2] = 0.5 * (drawn[0, (pitch_y - 1) // 2] + drawn[0, pitch_y // 2])
            grade[level, column] = tile.grade
    return Terrain(
        heights=heights,
        cell=cell,
        origin=origin,
        tile_origin=tile_origin,
        kind=tuple(tile.kind.name for tile in tiles[0]),
        grade=grade,
        tile_length=layout.tile_length,
        tile_width=layout.tile_width,
    )


def tile_points(length: float, width: float, cell: float) -> tuple[registry.Array, registry.Array]:
    """Where a tile's heights are: x from 0 to length and y from -width/2 to width/2, each [nx, ny], m."""
    x = np.arange(round(length / cell) + 1) * cell
    y = np.arange(round(width / cell) + 1) * cell - 0.5 * width
    grid_x, grid_y = np.meshgrid(x, y, indexing="ij")
    return grid_x, grid_y
