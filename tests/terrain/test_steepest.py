"""The steepest stretch of a tile, and tiles that are too short for what they have to hold."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.scene.tiles import Tiles
from humoslope.terrain import TerrainGridCfg, TerrainQueries, Tile, TileRowCfg, registry
from humoslope.terrain.grid import STANCE, steepest, tile_points
from humoslope.terrain.registry import Kind
from terrains.profiles import ramp
from terrains.stage2 import stage2
from terrains.surfaces import rough, striped, wavy

SURFACES = {
    "wavy": lambda x, y, rng: wavy(x, rng.uniform(0.03, 0.05), rng.uniform(1.0, 1.5), rng.uniform(0.0, 6.0)),
    "rough": lambda x, y, rng: rough(x, y, rng, 0.03),
    "ribbed": lambda x, y, rng: striped(x, 0.03, rng.choice((0.4, 0.5))),
    "smooth": lambda x, y, rng: 0.0 * x,
}


def tangent(degrees):
    return math.tan(math.radians(degrees))


@given(slope=st.floats(-60.0, 60.0), heading=st.floats(0.0, 360.0), cell=st.sampled_from((0.05, 0.1, 0.5)))
def test_a_plane_is_as_steep_as_it_is_at_any_heading(slope, heading, cell):
    x, y = tile_points(4.0, 3.0, cell)
    along = x * math.cos(math.radians(heading)) + y * math.sin(math.radians(heading))
    assert steepest(tangent(slope) * along, cell) == pytest.approx(abs(slope), abs=1e-6)


@settings(max_examples=30)
@given(
    surface=st.sampled_from(sorted(SURFACES)),
    grade=st.floats(0.0, 35.0),
    cell=st.sampled_from((0.05, 0.1)),
    seed=st.integers(0, 999),
)
def test_no_stretch_as_long_as_a_stance_is_steeper_than_the_tile_says(surface, grade, cell, seed):
    kind = Kind(surface, (0.0, 35.0), lambda x, y, grade, rng: ramp(x, grade) + SURFACES[surface](x, y, rng))
    terrain = TileRowCfg([Tile(kind, grade)], tile_length=8.0, cell=cell, seed=seed).build()
    queries = TerrainQueries(terrain, "cpu")
    rng = np.random.default_rng(seed)
    start = rng.uniform((0.0, -2.5), (8.0 - STANCE, 2.5 - STANCE), (4000, 2)) + terrain.tile_origin[0, 0, :2]
    worst = 0.0
    for step in ((STANCE, 0.0), (0.0, STANCE)):
        ends = [queries.height(torch.tensor(place, dtype=torch.float32)) for place in (start, start + step)]
        worst = max(worst, (ends[1] - ends[0]).abs().max().item() / STANCE)
    found = tangent(terrain.steepest[0, 0])
    assert worst <= found + 1e-4
    # A plane with nothing on it needs no more than its grade, and a surface not much more than its steepest stretch.
    assert (
        found <= math.hypot(worst, 0.25) + 0.05
        if surface != "smooth"
        else found == pytest.approx(tangent(grade), abs=1e-4)
    )


def test_each_tile_has_its_own_and_envs_read_that_of_their_tile():
    terrain = stage2().build()
    tiles = Tiles(terrain, 40, torch.device("cpu"))
    level = torch.arange(40) % tiles.num_levels
    tiles.set_level(level)
    expected = np.radians(terrain.steepest[level.numpy(), tiles.column.numpy()])
    np.testing.assert_allclose(tiles.steepest.numpy(), expected, rtol=1e-6)
    ramps = [k for k, name in enumerate(terrain.kind) if name.startswith("ramp")]
    np.testing.assert_allclose(terrain.steepest[:, ramps], terrain.grade[:, ramps], atol=1e-3)
    flat = terrain.kind.index("flat")
    assert (terrain.steepest[:, flat] == 0.0).all()
    # What the nominal grade does not tell: at the same grade, no two tracks are equally steep.
    tracks = [k for k, name in enumerate(terrain.kind) if name == "compound"]
    assert np.ptp(terrain.steepest[9, tracks]) > 3.0


@pytest.mark.parametrize("width", [2.5, 2.6])
def test_the_start_of_the_centre_line_lies_at_its_height_on_tiles_of_odd_and_even_width(width):
    kind = Kind("tilted", (0.0, 0.0), lambda x, y, grade, rng: 0.3 * y + 1.0)
    terrain = TileRowCfg([Tile(kind, 0.0)], tile_width=width).build()
    assert terrain.tile_origin[0, 0, 2] == pytest.approx(1.0, abs=1e-9)
    assert terrain.tile_origin[0, 0, 1] == pytest.approx(0.0, abs=1e-9)


# Lengths


@settings(max_examples=60)
@given(
    name=st.sampled_from([name for name in registry.names() if name.split("-")[-1] in ("up", "down", "compound")]),
    cells=st.integers(8, 120),
)
def test_a_tile_keeps_its_slope_or_is_refused_with_a_length_that_keeps_it(name, cells):
    def build(length):
        return TerrainGridCfg(columns={name: 1.0}, levels=3, num_columns=2, tile_length=length, cell=0.1).build()

    length = cells * 0.1
    try:
        built = build(length)
    except UserError as error:
        said = str(error)
        assert said.startswith(f"terrain '{name}'")
        assert "\n" not in said
        length = float(said.partition("tile_length must be at least ")[2].partition(" m")[0])
        assert length > cells * 0.1
        built = build(length)
    for level in range(3):
        assert (built.steepest[level] >= built.grade[level] - 0.5).all()
        heights = built.tile_heights(built.tile_origin[level, 0])[:, 0]
        sloped = np.abs(np.diff(heights, axis=0)) > 0.5 * 0.1 * tangent(built.grade[level, 0])
        assert level == 0 or sloped.sum() * 0.1 >= 0.8  # m


@given(length=st.floats(1.0, 3.4))
def test_a_terrain_of_ones_own_that_loses_its_slope_is_refused_with_a_length_that_keeps_it(length):
    def heights(x, y, grade, rng):
        return tangent(grade) * np.maximum(x - 3.4, 0.0)

    length = round(length, 1)
    tiles = [Tile(Kind("late", (0.0, 20.0), heights), 20.0)]
    with pytest.raises(UserError, match=r"terrain 'late': a tile of .* is nowhere steeper than 0\.0 degrees") as caught:
        TileRowCfg(tiles, tile_length=length).build()
    enough = float(str(caught.value).partition("tile_length ")[2].partition(" m")[0])
    assert TileRowCfg(tiles, tile_length=enough).build().steepest[0, 0] > 10.0


def test_a_terrain_that_never_uses_its_grade_is_refused():
    kind = Kind("level", (0.0, 20.0), lambda x, y, grade, rng: 0.0 * x)
    with pytest.raises(UserError, match="'level': .* a longer one is not either; its function must use the grade"):
        TileRowCfg([Tile(kind, 20.0)]).build()
