"""Profiles and surfaces are what they say, and add up."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from humoslope.terrain import TerrainGridCfg, registry
from humoslope.terrain.grid import tile_points
from terrains.profiles import Segment, plane, ramp, ramp_down, track
from terrains.surfaces import SPAWN, banked, rough, smooth, striped, wavy
from tests.terrain.ground import STRAIGHT

X, Y = tile_points(10.0, 5.0, 0.1)


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


SURFACES = {
    "smooth": lambda: smooth(X),
    "wavy": lambda: wavy(X),
    "banked": lambda: banked(X, Y, 8.0),
    "rough": lambda: rough(X, Y, rng()),
    "striped": lambda: striped(X),
}


@pytest.mark.parametrize("name", SURFACES)
def test_a_surface_leaves_the_place_where_robots_start_alone(name: str) -> None:
    np.testing.assert_array_equal(SURFACES[name]()[X <= SPAWN], 0.0)


@given(grade=st.floats(-40, 40), length=st.floats(4.0, 20.0))
def test_a_ramp_rises_between_approach_and_run_out_by_the_tangent_of_its_grade(grade: float, length: float) -> None:
    x = np.linspace(0.0, length, 301)[:, None]
    heights = ramp(x, grade)
    rise = (length - 3.0) * np.tan(np.radians(grade))
    np.testing.assert_array_equal(heights[x <= 1.5], 0.0)
    np.testing.assert_allclose(heights[x >= length - 1.5], rise, atol=1e-9)
    np.testing.assert_allclose(heights, np.interp(x, [1.5, length - 1.5], [0.0, rise]), atol=1e-9)
    np.testing.assert_allclose(heights, -ramp_down(x, grade))


@given(grade=st.floats(-40, 40), length=st.floats(4.0, 20.0))
def test_a_ramp_is_a_track_of_a_flat_a_slope_and_a_flat(grade: float, length: float) -> None:
    x = np.linspace(0.0, length, 301)[:, None]
    segments = [Segment(1.5, 0.0), Segment(length - 3.0, grade)]
    np.testing.assert_allclose(track(x, segments), ramp(x, grade), atol=1e-9)


def test_ramps_up_and_down_are_equally_steep_and_steeper_than_the_evaluation() -> None:
    for name in ("ramp-up", "ramp-down", "rough-ramp-up", "rough-ramp-down", "striped-ramp-up", "striped-ramp-down"):
        assert registry.find(name).grade == (0.0, 32.0)
    assert registry.find("compound").grade == (0.0, 35.0)


def test_banked_ground_tilts_by_its_angle() -> None:
    tilt = np.degrees(np.arctan(np.diff(banked(X, Y, 8.0), axis=1) / 0.1))
    np.testing.assert_allclose(tilt[X[:, 0] > 2.1], 8.0)


def test_bumps_stay_within_their_amplitude_and_reach_most_of_it() -> None:
    assert 0.028 < np.abs(rough(X, Y, rng(), 0.03)).max() <= 0.03


def test_bumps_are_the_same_ground_on_a_finer_grid() -> None:
    x, y = tile_points(10.0, 5.0, 0.05)
    np.testing.assert_allclose(rough(x, y, rng())[::2, ::2], rough(X, Y, rng()), atol=1e-12)


@pytest.mark.parametrize("period", [0.4, 0.5])
def test_ribs_are_as_high_as_asked_with_level_ground_between(period: float) -> None:
    ribs = striped(X, 0.03, period)[20:, 0]
    assert ribs.max() == pytest.approx(0.03)
    assert ribs.min() == 0.0
    assert (ribs > 0.015).sum() == pytest.approx(8.0 / period, abs=1.0)


@pytest.mark.parametrize("name", STRAIGHT)
def test_no_kind_asks_a_robot_to_climb_a_step_inside_its_tile(name: str) -> None:
    kind = registry.find(name)
    for seed in range(10):
        heights = kind.heights(X, Y, kind.grade[1], np.random.default_rng(seed))
        steepest = np.tan(np.radians(35.0)) * 0.1 + 0.06  # a ramp, and one bump from lowest to highest
        assert np.abs(np.diff(heights, axis=0)).max() <= steepest + 1e-9
        assert np.abs(np.diff(heights, axis=1)).max() <= 0.06 + 1e-9


@given(grade=st.floats(0, 40), uphill=st.floats(-180, 180), x=st.floats(0, 10), y=st.floats(-2.5, 2.5))
def test_a_plane_rises_by_its_grade_in_its_direction_and_is_level_across_it(
    grade: float, uphill: float, x: float, y: float
) -> None:
    ahead = np.array([np.cos(np.radians(uphill)), np.sin(np.radians(uphill))])
    heights = plane(X, Y, grade, uphill)
    i, j = round(x / 0.1), round((y + 2.5) / 0.1)
    offset = np.array([X[i, j] - 5.0, Y[i, j]])
    assert heights[i, j] == pytest.approx(np.tan(np.radians(grade)) * (offset @ ahead), abs=1e-9)


@given(grade=st.floats(0, 32), seed=st.integers(0, 99))
def test_a_hillside_is_one_plane_of_its_grade_from_edge_to_edge(grade: float, seed: int) -> None:
    kind = registry.find("hillside")
    heights = kind.heights(X, Y, grade, np.random.default_rng(seed))
    along, across = np.gradient(heights, 0.1)
    np.testing.assert_allclose(np.degrees(np.arctan(np.hypot(along, across))), grade, atol=1e-6)
    assert heights.mean() == pytest.approx(0.0, abs=1e-9)


def test_hillsides_rise_in_every_direction() -> None:
    kind, directions = registry.find("hillside"), []
    for seed in range(40):
        heights = kind.heights(X, Y, 20.0, np.random.default_rng(seed))
        directions.append(np.arctan2(heights[0, 1] - heights[0, 0], heights[1, 0] - heights[0, 0]))
    assert np.histogram(directions, bins=4, range=(-np.pi, np.pi))[0].min() >= 3


@given(grade=st.floats(1, 32), seed=st.integers(0, 99))
def test_a_rough_hillside_is_a_hillside_with_bumps_of_up_to_three_centimetres(grade: float, seed: int) -> None:
    heights = registry.find("rough-hillside").heights(X, Y, grade, np.random.default_rng(seed))
    base = np.c_[np.ones(X.size), X.ravel(), Y.ravel()]
    fit = base @ np.linalg.lstsq(base, heights.ravel(), rcond=None)[0]
    bumps = np.abs(heights.ravel() - fit).max()
    assert 0.6 * 0.03 * grade / 32.0 < bumps < 1.4 * 0.03 * grade / 32.0


def test_only_hillsides_are_walked_in_any_direction_and_the_grid_says_in_which_columns() -> None:
    free = [name for name in registry.names() if registry.find(name).omnidirectional]
    assert free == ["hillside", "rough-hillside"]
    columns = {"hillside": 2.0, "flat": 1.0}
    assert TerrainGridCfg(columns=columns, levels=2, num_columns=3).build().omnidirectional == {0, 1}
    assert TerrainGridCfg(columns={"flat": 1.0}, levels=2, num_columns=3).build().omnidirectional == frozenset()
