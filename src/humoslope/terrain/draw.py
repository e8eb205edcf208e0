"""Pictures of a terrain: its tiles from the side and from above, at several difficulties."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from humoslope.errors import UserError
from humoslope.files import write_atomically
from humoslope.plotting import with_ending
from humoslope.terrain import course, registry
from humoslope.terrain.course import Course
from humoslope.terrain.grid import SPAWN_X, TerrainGridCfg, tile_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DIFFICULTIES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Difficulties that are drawn."""
INK = "#333333"


def run(name: str, out: Path, *, seed: int = 0) -> Path:
    """Writes a PNG of a registered terrain: profiles along the centre line, and relief coloured by the local grade.

    A terrain of one grade is drawn once, any other at `DIFFICULTIES`, on tiles of the default size. A course has its
    own size, and its segments are named.

    Args:
        name: Name of the terrain.
        out: File to write; folders are made.
        seed: Seed of the random numbers. A grid has other random tiles of the same kind, since it has more levels.

    Returns:
        Path of the picture.

    Raises:
        UserError: If there is no such terrain, or the picture cannot be written or is no PNG.
    """
    out = with_ending(out)
    if out.suffix != ".png":
        raise UserError(f"the picture of a terrain is a PNG; '{out}' must end in .png.")
    kind = registry.find(name)
    difficulties = DIFFICULTIES[:1] if kind.grade[0] == kind.grade[1] else DIFFICULTIES
    drawn = course.find(name) if course.is_course(name) else None
    if drawn is not None:
        x, y = tile_points(drawn.length, drawn.width, drawn.cell)
    else:
        grid = TerrainGridCfg(columns={name: 1.0})
        x, y = tile_points(grid.tile_length, grid.tile_width, grid.cell)
    tiles = []
    for level, difficulty in enumerate(difficulties):
        grade = kind.grade_at(difficulty)
        tiles.append((grade, kind.heights(x, y, grade, np.random.default_rng((seed, 0, level)))))
    write_atomically(out, lambda temporary: _draw(name, x, y, tiles, temporary, drawn))
    return out


def local_grade(heights: registry.Array, cell: float) -> registry.Array:
    """Steepest grade of every cell's mean plane in degrees, [nx - 1, ny - 1] from heights [nx, ny] in metres."""
    rise = np.diff(heights, axis=0)
    bank = np.diff(heights, axis=1)
    along_x = 0.5 * (rise[:, 1:] + rise[:, :-1])
    along_y = 0.5 * (bank[1:] + bank[:-1])
    return np.degrees(np.arctan(np.hypot(along_x, along_y) / cell))


def _draw(
    name: str,
    x: registry.Array,
    y: registry.Array,
    tiles: list[tuple[float, registry.Array]],
    out: Path,
    drawn: Course | None,
) -> None:
    # Drawn without pyplot, so that neither a screen nor the backend the user chose matters.
    from matplotlib import colormaps
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    cell = float(x[1, 0] - x[0, 0])
    grades = [local_grade(heights, cell) for _, heights in tiles]
    steepest = max(5.0, *(float(np.percentile(grade, 99.0)) for grade in grades))
    colour = ScalarMappable(Normalize(0.0, steepest), colormaps["viridis"])

    columns = min(len(tiles), 3) if drawn is None else 1
    rows = -(-len(tiles) // columns)
    extent = (float(x.min()), float(x.max()), float(y.min()), float(y.max()))
    # Tiles keep their proportions, so the height of the page follows from its width.
    relief_height = rows * (9.6 / columns * (extent[3] - extent[2]) / extent[1] + 0.3) + 0.5
    figure = Figure(figsize=(11.0, 3.2 + relief_height), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(f"{name}: {_range(tiles[0][0], tiles[-1][0])}", color=INK, fontsize=13)
    parts = np.asarray(figure.subfigures(2, 1, height_ratios=(2.8, relief_height)))
    top, bottom = parts[0], parts[1]
    profile = top.subplots()
    _draw_profiles(profile, x, y, tiles)
    marked = drawn is None and not registry.find(name).omnidirectional  # robots start at one place
    if marked:
        profile.axvline(SPAWN_X, color="#b03a2e", linewidth=1.0, linestyle=":", label="start")
    if drawn is not None:
        _name_segments(profile, drawn)
    profile.legend(fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5), reverse=True)

    axes = bottom.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for index, axis in enumerate(axes):
        axis.tick_params(labelsize=8, colors=INK, labelbottom=index + columns >= len(tiles))
        axis.set_visible(index < len(tiles))
    for axis, (grade, heights), local in zip(axes, tiles, grades, strict=False):
        rgb = colour.to_rgba(local)[..., :3] * _shade(heights, cell)[..., None]
        axis.imshow(np.clip(rgb, 0.0, 1.0).transpose(1, 0, 2), origin="lower", extent=extent, interpolation="nearest")
        if marked:
            axis.plot(SPAWN_X, 0.0, "o", color="white", markeredgecolor=INK, markersize=5)
        axis.set_title(f"grade {grade:.1f}°", fontsize=9, color=INK, loc="left", pad=3)
    bottom.supxlabel("along the direction of travel, m", fontsize=9, color=INK)
    bottom.supylabel("across, m", fontsize=9, color=INK)
    bottom.colorbar(colour, ax=list(axes), label="local grade, degrees", extend="max", aspect=30, pad=0.01)
    figure.savefig(out, dpi=130)


def _draw_profiles(axis: Axes, x: registry.Array, y: registry.Array, tiles: list[tuple[float, registry.Array]]) -> None:
    """Heights along the centre line; the steeper the tile, the darker its line."""
    middle = y.shape[1] // 2
    for index, (grade, heights) in enumerate(tiles):
        tone = 0.1 + 0.65 * (1.0 - (index + 1) / len(tiles))
        axis.plot(x[:, middle], heights[:, middle], color=str(tone), linewidth=1.5, label=f"grade {grade:.1f}°")
    low, high = axis.get_ylim()
    if high - low < 0.4:  # a flat line needs room to look flat
        axis.set_ylim(0.5 * (low + high) - 0.2, 0.5 * (low + high) + 0.2)
    axis.set_xlim(float(x.min()), float(x.max()))
    axis.set_ylabel("height on the\ncentre line, m", fontsize=9, color=INK)
    axis.tick_params(labelsize=8, colors=INK)
    axis.grid(color="0.9")
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)


def _name_segments(axis: Axes, drawn: Course) -> None:
    """Shades every other segment, and writes its name above it."""
    start = 0.0
    for index, (segment, end) in enumerate(zip(drawn.segments, drawn.ends, strict=True)):
        if index % 2:
            axis.axvspan(start, end, color="0.95", zorder=0)
        words = segment.name.replace(" ", "\n")
        axis.text(0.5 * (start + end), 1.02, words, transform=axis.get_xaxis_transform(), fontsize=7, ha="center")
        start = end


def _range(low: float, high: float) -> str:
    return f"grade {low:g}°" if low == high else f"grades {low:g}° to {high:g}°"


def _shade(heights: registry.Array, cell: float) -> registry.Array:
    """Brightness of every cell under a light from the upper left, about 1, shape [nx - 1, ny - 1]."""
    slope_x = np.diff(heights, axis=0)[:, :-1] / cell
    slope_y = np.diff(heights, axis=1)[:-1] / cell
    light = np.array((-0.45, 0.45, 0.77))
    cosine = (-slope_x * light[0] - slope_y * light[1] + light[2]) / np.sqrt(1.0 + slope_x**2 + slope_y**2)
    return np.clip(cosine / light[2], 0.55, 1.3)
