"""Grids lay tiles out by kind and level, and refuse what cannot be built."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.terrain import Terrain, TerrainGridCfg, Tile, TileRowCfg, registry, terrain
from terrains.stage1 import stage1
from tests.terrain.ground import STRAIGHT, TRAINING


@pytest.fixture(autouse=True)
def registry_left_as_found(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with monkeypatch.context() as patch:
        patch.setattr(registry, "_REGISTRY", dict(registry._REGISTRY))
        yield


def tile(built: Terrain, level: int, column: int) -> Any:
    """Heights of one tile, [nx, ny]."""
    corner = built.tile_origin[level, column, :2] - (0.0, 0.5 * built.tile_width) - np.array(built.origin)
    i, j = np.round(corner / built.cell).astype(int)
    return built.heights[
        i : i + round(built.tile_length / built.cell) + 1, j : j + round(built.tile_width / built.cell) + 1
    ]


def test_every_tile_walked_along_x_starts_level_at_its_origin_and_robots_start_on_level_ground() -> None:
    built = TerrainGridCfg(columns=dict.fromkeys(STRAIGHT, 1.0), levels=5).build()
    for level in range(5):
        for column in range(20):
            heights = tile(built, level, column)
            np.testing.assert_allclose(heights[:13], built.tile_origin[level, column, 2], atol=1e-9)
    assert built.spawn_x == 0.75


def test_the_field_is_centred_in_the_world() -> None:
    built = TerrainGridCfg(columns={"flat": 1.0}, levels=3, num_columns=2).build()
    far = np.array(built.origin) + (np.array(built.heights.shape) - 1) * built.cell
    np.testing.assert_allclose(far, -np.array(built.origin))
    np.testing.assert_allclose(built.tile_origin[..., 1].sum(), 0.0, atol=1e-9)


def test_levels_run_through_the_grades_and_along_x() -> None:
    built = TerrainGridCfg(columns={"ramp-up": 1.0}, levels=5, num_columns=2).build()
    np.testing.assert_allclose(built.grade, np.linspace(0, 32, 5)[:, None].repeat(2, axis=1))
    assert (np.diff(built.tile_origin[:, 0, 0]) > built.tile_length).all()
    assert (np.diff(built.tile_origin[0, :, 1]) > built.tile_width).all()


@pytest.mark.parametrize(("name", "sign"), [("ramp-up", 1), ("ramp-down", -1)])
def test_a_ramp_of_30_degrees_is_30_degrees_everywhere_but_at_its_ends(name: str, sign: int) -> None:
    find = registry.find(name)
    terrain("only-30", grade=(30.0, 30.0))(find.function)
    heights = tile(TerrainGridCfg(columns={"only-30": 1.0}, levels=1, num_columns=1).build(), 0, 0).astype(float)
    grade_x = np.degrees(np.arctan(np.diff(heights, axis=0) / 0.1))
    np.testing.assert_allclose(grade_x[15:85], sign * 30.0, atol=1e-3)
    np.testing.assert_allclose(grade_x[:15], 0.0, atol=1e-9)
    np.testing.assert_allclose(grade_x[85:], 0.0, atol=1e-3)
    np.testing.assert_allclose(np.diff(heights, axis=1), 0.0, atol=1e-9)


@settings(deadline=None)
@given(
    shares=st.dictionaries(st.sampled_from(TRAINING), st.floats(0.01, 100), min_size=1),
    more=st.integers(0, 9),
)
def test_every_named_kind_gets_a_column_and_shares_are_kept_within_one(shares: dict[str, float], more: int) -> None:
    columns = len(shares) + more
    built = TerrainGridCfg(
        columns=shares, levels=1, num_columns=columns, tile_length=7.0, tile_width=0.4, cell=0.2, border=0.0
    ).build()
    assert len(built.kind) == columns
    assert set(built.kind) == set(shares)
    for name, share in shares.items():
        fair = share / sum(shares.values()) * columns
        assert built.kind.count(name) < fair + 1.0 or built.kind.count(name) == 1


def test_a_share_of_zero_takes_a_kind_away() -> None:
    built = TerrainGridCfg(columns={"flat": 1.0, "wave": 0.0}, levels=1, num_columns=4).build()
    assert set(built.kind) == {"flat"}


def test_a_tile_depends_on_seed_column_and_level_only() -> None:
    small = TerrainGridCfg(columns={"rough": 1.0}, levels=2, num_columns=2)
    large = TerrainGridCfg(columns={"rough": 1.0}, levels=2, num_columns=5)
    other = TerrainGridCfg(columns={"rough": 1.0}, levels=2, num_columns=2, seed=1)
    np.testing.assert_array_equal(tile(small.build(), 1, 1), tile(large.build(), 1, 1))
    assert (tile(small.build(), 1, 1) != tile(other.build(), 1, 1)).any()
    assert (tile(small.build(), 1, 0) != tile(small.build(), 1, 1)).any()


def test_stage_one_is_more_than_half_hillsides_with_ramps_and_flat_wavy_and_rough_ground() -> None:
    built = stage1().build()
    assert {name: built.kind.count(name) for name in built.kind} == {
        "hillside": 8,
        "rough-hillside": 3,
        "flat": 1,
        "ramp-up": 2,
        "ramp-down": 2,
        "rough-ramp-up": 1,
        "rough-ramp-down": 1,
        "wave": 1,
        "rough": 1,
    }
    assert np.isfinite(built.heights).all()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"levels": 0}, "levels is 0"),
        ({"num_columns": 0}, "num_columns is 0"),
        ({"cell": 0.0}, r"cell is 0; it must be between 0\.001 and 10,000 \(too low\)\.$"),
        ({"cell": -0.1}, "cell is -0.1"),
        ({"cell": float("nan")}, "cell is nan"),
        ({"cell": 6.0}, "cell is 6.0 m, larger than tile_width"),
        ({"cell": 0.3}, "whole number of cells"),
        ({"tile_length": 0.5}, "robots start at 0.75 m, so it must be longer"),
        ({"tile_width": -1.0}, r"tile_width is -1; it must be between 0\.001 and 10,000 \(too low\)\.$"),
        ({"border": -1.0}, r"border is -1; it must be between 0 and 1,000 \(too low\)\.$"),
        ({"seed": -1}, "seed is -1"),
        ({"levels": 1000, "num_columns": 1000}, "room for 20 million; choose a cell of at least"),
        ({"cell": 0.002}, "million heights, of which there is room for 20 million"),
        ({"columns": {}}, "sum to 0"),
        ({"columns": {"flat": 0.0}}, "sum to 0"),
        (
            {"columns": {"flat": 1.0, "wave": -0.5}},
            r"columns is \{'flat': 1\.0, 'wave': -0\.5\}; of 'wave', it must be 0 or more \(too low\)\.$",
        ),
        ({"columns": {"flat": float("inf")}}, r"columns is \{'flat': inf\}; of 'flat', it must be 0 or more"),
        ({"columns": {"flat": 1.0, "wave": 1.0}, "num_columns": 1}, "do not fit"),
        ({"columns": {"ramp-upp": 1.0}}, "did you mean 'ramp-up'"),
    ],
)
def test_an_impossible_grid_is_refused_in_one_sentence(change: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said) as caught:
        TerrainGridCfg(**{"columns": {"flat": 1.0}, "levels": 2, **change}).build()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("returned", "said"),
    [
        (lambda x: 0.0, "returned a float"),
        (lambda x: None, "returned a NoneType"),
        (lambda x: x.astype(str), "must be real numbers"),
        (lambda x: x[:-1], r"shape \(100, 51\); it must be that of x, \(101, 51\)"),
        (lambda x: np.where(x > 5.0, np.nan, 0.0), "returned nan at x=5.10"),
        (lambda x: np.where(x > 5.0, np.inf, 0.0), "every height must be finite"),
    ],
)
def test_a_terrain_that_returns_no_ground_is_named_with_what_it_returned(returned: Any, said: str) -> None:
    terrain("broken", grade=(0.0, 10.0))(lambda x, y, grade, rng: returned(x))
    with pytest.raises(UserError, match=said) as caught:
        TerrainGridCfg(columns={"broken": 1.0}).build()
    assert "'broken'" in str(caught.value)


def test_a_name_is_registered_once() -> None:
    with pytest.raises(UserError, match=r"'flat' is registered twice, by terrains\.kinds\.flat_ground"):
        terrain("flat", grade=(0.0, 1.0))(lambda x, y, grade, rng: x)


@pytest.mark.parametrize("grade", [(10.0, 0.0), (0.0, 90.0), (float("nan"), 1.0)])
def test_a_range_of_grades_that_cannot_be_is_refused(grade: tuple[float, float]) -> None:
    with pytest.raises(UserError, match="give \\(low, high\\) in degrees"):
        terrain("new", grade=grade)


def test_a_row_lays_its_tiles_out_side_by_side_as_they_were_asked_for() -> None:
    kind = registry.find("ramp-up")
    built = TileRowCfg([Tile(kind, 10.0), Tile(kind, 0.0), Tile(kind, 45.0)], tile_length=12.0).build()
    assert built.kind == ("ramp-up",) * 3
    np.testing.assert_array_equal(built.grade, [[10.0, 0.0, 45.0]])
    for column, grade in enumerate((10.0, 0.0, 45.0)):
        grade_x = np.degrees(np.arctan(np.diff(tile(built, 0, column).astype(float), axis=0) / 0.1))
        np.testing.assert_allclose(grade_x[20:100], grade, atol=1e-3)


def test_a_row_of_a_grids_tiles_is_that_grid() -> None:
    grid = TerrainGridCfg(columns={"rough": 1.0}, levels=1, num_columns=3, seed=4).build()
    row = TileRowCfg([Tile(registry.find("rough"), 0.0)] * 3, seed=4).build()
    np.testing.assert_array_equal(grid.heights, row.heights)
    np.testing.assert_array_equal(grid.tile_origin, row.tile_origin)


def test_a_row_without_tiles_is_refused() -> None:
    with pytest.raises(UserError, match="no tiles"):
        TileRowCfg([]).build()
