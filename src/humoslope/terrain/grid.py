"""Tiles of registered terrains laid out by kind and difficulty, as one height field."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from humoslope.errors import UserError
from humoslope.memory import require_memory
from humoslope.ranges import NotNegative, Range, Seed, check_config
from humoslope.terrain import registry

SPAWN_X = 0.75
"""Distance of a robot's start from the start of its tile, m."""

STANCE = 0.3
"""Length over which the inclination of the ground is taken for friction, m: a foot and a half of the G1. The side of a
shorter bump carries only a part of a foot. Ours."""

SLOPE_KEPT = 0.5
"""Share of its grade, as a tangent, that a tile must really have somewhere; with less, its slope has been lost."""

MOST_HEIGHTS = 20_000_000
"""Most heights of a ground: with what is derived from them they take some 2 GB, and a minute or two to draw. Ours."""
BYTES_PER_HEIGHT = 100
"""Memory that a height takes with what is derived from it, as above."""

Metres = Annotated[float, Range(0.001, 10_000.0)]

LONGEST = 60.0
"""Longest tile that is tried to find a length that would do, m."""


@dataclass(frozen=True)
class Terrain:
    """Height field of tiles, in the world frame; levels lie along world x, the direction of travel, columns along y.

    Attributes:
        heights: [nx, ny] float32, m; the first index runs along x.
        cell: Distance between neighbouring heights, m.
        origin: World x, y of `heights[0, 0]`, m.
        tile_origin: [levels, columns, 3] world position of the start of each tile's centre line, m.
        kind: Name of the terrain in each column.
        grade: [levels, columns] nominal grade of each tile, degrees, without a sign for up or down.
        tile_length: Extent of a tile along x, m.
        tile_width: Extent of a tile along y, m.
        spawn_x: Distance of a robot's start from the start of its tile, m.
        omnidirectional: Columns of tiles that robots walk in any direction from any place; the others are walked from
            their start along x.
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
    omnidirectional: frozenset[int] = frozenset()

    @property
    def is_flat(self) -> bool:
        """True if every height is the same."""
        return bool((self.heights == self.heights[0, 0]).all())

    @cached_property
    def steepest(self) -> NDArray[np.float64]:
        """Largest inclination on each tile over a length of `STANCE`, [levels, columns] degrees; see `steepest`."""
        tiles = self.tile_origin.reshape(-1, 3)
        found = [steepest(self.tile_heights(place), self.cell) for place in tiles]
        return np.array(found).reshape(self.tile_origin.shape[:2])

    def tile_heights(self, start: NDArray[np.float64]) -> NDArray[np.float32]:
        """Heights [nx, ny] of the tile whose centre line starts at `start` [3] (a row of `tile_origin`), m."""
        corner = (start[0] - self.origin[0], start[1] - 0.5 * self.tile_width - self.origin[1])
        i, j = (round(edge / self.cell) for edge in corner)
        nx, ny = (round(extent / self.cell) + 1 for extent in (self.tile_length, self.tile_width))
        return self.heights[i : i + nx, j : j + ny]


@dataclass(frozen=True)
class TerrainGridCfg:
    """Configuration of a terrain for training: a grid of tiles by kind and level.

    Each tile is drawn on its own and keeps a seam of one cell to its neighbours, in which any step in height lies.

    Attributes:
        columns: Share of the columns for each registered terrain. Shares need not sum to one; a share of 0 removes a
            terrain, any other is worth at least one column.
        levels: Number of difficulties; level i has difficulty i / (levels - 1), and a single level is the easiest.
        num_columns: Number of tiles side by side at each level.
        tile_length: Extent of a tile in the direction of travel, m.
        tile_width: Extent of a tile across the direction of travel, m.
        cell: Distance between neighbouring heights, m; tiles are a whole number of cells.
        border: Width of the flat ground around all tiles, m.
        seed: Seed of the random numbers; a tile depends only on (seed, column, level).
    """

    columns: Mapping[str, NotNegative]
    levels: Annotated[int, Range(1, 1000)] = 10
    num_columns: Annotated[int, Range(1, 1000)] = 20
    tile_length: Metres = 10.0
    tile_width: Metres = 5.0
    cell: Metres = 0.1
    border: Annotated[float, Range(0.0, 1000.0)] = 3.0
    seed: Seed = 0

    def build(self) -> Terrain:
        """Draws every tile.

        Raises:
            UserError: If a value is impossible, a terrain's function returns no ground, or a tile is too small for what
                it has to hold.
        """
        check_config("terrain", self)
        _check_extents(self)
        kinds = [registry.find(name) for name in self._column_names()]
        difficulties = [level / max(self.levels - 1, 1) for level in range(self.levels)]
        terrain = _lay_out(self, [[Tile(kind, kind.grade_at(d)) for kind in kinds] for d in difficulties])
        omnidirectional = frozenset(column for column, kind in enumerate(kinds) if kind.omnidirectional)
        return replace(terrain, omnidirectional=omnidirectional)

    def _column_names(self) -> list[str]:
        for name in self.columns:
            if not registry.find(name).training:
                raise UserError(f"terrain grid: '{name}' is for evaluation only; policies must not train on it.")
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
    """Terrain at a grade in degrees."""

    kind: registry.Kind
    grade: float


@dataclass(frozen=True)
class TileRowCfg:
    """Configuration of a terrain for measurements: tiles side by side, each with its own grade.

    Whatever its kind, a tile is walked from its start along x.

    Attributes:
        tiles: One tile for each column of the only level; its terrain need not be registered.
        tile_length, tile_width, cell, border, seed: As in `TerrainGridCfg`.
    """

    tiles: Sequence[Tile]
    tile_length: Metres = 10.0
    tile_width: Metres = 5.0
    cell: Metres = 0.1
    border: Annotated[float, Range(0.0, 1000.0)] = 3.0
    seed: Seed = 0

    def build(self) -> Terrain:
        """Draws every tile; raises `UserError` as `TerrainGridCfg.build`."""
        if not self.tiles:
            raise UserError("terrain: a row has no tiles; give it at least one.")
        check_config("terrain", self)
        _check_extents(self)
        return _lay_out(self, [self.tiles])


def _check_extents(layout: TerrainGridCfg | TileRowCfg) -> None:
    for field in ("tile_length", "tile_width", "cell"):
        if getattr(layout, field) < layout.cell:
            raise UserError(f"terrain: cell is {layout.cell} m, larger than {field}, {getattr(layout, field)} m.")
    for field in ("tile_length", "tile_width"):
        extent = getattr(layout, field)
        if abs(extent / layout.cell - round(extent / layout.cell)) > 1e-6:
            raise UserError(f"terrain: {field}, {extent} m, must be a whole number of cells of {layout.cell} m.")
    if layout.tile_length <= SPAWN_X:
        raise UserError(
            f"terrain: tile_length is {layout.tile_length} m; robots start at {SPAWN_X} m, so it must be longer."
        )
    levels, columns = _tiles_of(layout)
    heights = math.prod(
        count * (extent / layout.cell + 1) + 2 * layout.border / layout.cell
        for count, extent in ((levels, layout.tile_length), (columns, layout.tile_width))
    )
    if heights > MOST_HEIGHTS:
        finest = layout.cell * math.sqrt(heights / MOST_HEIGHTS)
        raise UserError(
            f"terrain: {levels} x {columns} tiles of {layout.tile_length:g} x {layout.tile_width:g} m have "
            f"{heights / 1e6:.0f} million heights, of which there is room for {MOST_HEIGHTS / 1e6:.0f} million; choose "
            f"a cell of at least {finest:.2g} m, or fewer or smaller tiles."
        )
    require_memory("the number of heights of the ground", round(heights), BYTES_PER_HEIGHT)


def _tiles_of(layout: TerrainGridCfg | TileRowCfg) -> tuple[int, int]:
    """Numbers of tiles along x and along y."""
    return (layout.levels, layout.num_columns) if isinstance(layout, TerrainGridCfg) else (1, len(layout.tiles))


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
            if not _keeps_slope(drawn, cell, tile.grade):
                raise _slope_lost(layout, tile, (layout.seed, column, level), steepest(drawn, cell))
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


def steepest(heights: NDArray[np.floating[Any]], cell: float) -> float:
    """Largest inclination of a tile over a length of `STANCE`, degrees.

    At each place it is that of the plane through the height there and those a stance further along x and along y, which
    is exact for a plane of any heading and at least the inclination of every stretch of that length along x or y. The
    length is rounded to whole cells, and is at least one.

    Args:
        heights: [nx, ny] m.
        cell: Distance between neighbouring heights, m.
    """
    along_x, along_y = _slopes(heights, cell), _slopes(heights.T, cell).T
    return math.degrees(math.atan(float(np.hypot(along_x, along_y).max())))


def _slopes(heights: NDArray[np.floating[Any]], cell: float) -> registry.Array:
    """Rise per metre along the first axis from every place over a stance, in the shape of `heights`.

    Near the end of the tile it is that of the last stance on it; a tile shorter than a stance is one itself.
    """
    steps = min(max(1, round(STANCE / cell)), len(heights) - 1)
    slopes = np.empty(heights.shape)
    np.subtract(heights[steps:], heights[:-steps], out=slopes[:-steps], dtype=np.float64)
    slopes[:-steps] /= steps * cell
    slopes[-steps:] = slopes[-steps - 1]
    return slopes


def _keeps_slope(heights: registry.Array, cell: float, grade: float) -> bool:
    return math.tan(math.radians(steepest(heights, cell))) >= SLOPE_KEPT * math.tan(math.radians(abs(grade)))


def _slope_lost(layout: TerrainGridCfg | TileRowCfg, tile: Tile, seed: tuple[int, ...], found: float) -> UserError:
    """The error for a tile that is nowhere as steep as its grade, with a length that would do if there is one."""
    said = (
        f"terrain '{tile.kind.name}': a tile of {layout.tile_length:g} m at grade {tile.grade:.1f} degrees is nowhere "
        f"steeper than {found:.1f} degrees"
    )
    for metres in range(math.ceil(layout.tile_length), math.ceil(LONGEST) + 1):
        length = math.ceil(metres / layout.cell - 1e-9) * layout.cell
        x, y = tile_points(length, layout.tile_width, layout.cell)
        try:
            longer = tile.kind.heights(x, y, tile.grade, np.random.default_rng(seed))
        except UserError:
            continue
        if _keeps_slope(longer, layout.cell, tile.grade):
            return UserError(f"{said}; tile_length {length:g} m would do.")
    return UserError(f"{said}, and a longer one is not either; its function must use the grade.")


def tile_points(length: float, width: float, cell: float) -> tuple[registry.Array, registry.Array]:
    """Places of a tile's heights: x from 0 to length and y from -width/2 to width/2, each [nx, ny], m."""
    x = np.arange(round(length / cell) + 1) * cell
    y = np.arange(round(width / cell) + 1) * cell - 0.5 * width
    grid_x, grid_y = np.meshgrid(x, y, indexing="ij")
    return grid_x, grid_y
