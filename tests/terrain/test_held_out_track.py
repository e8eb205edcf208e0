"""The held-out track is what it is said to be, at every grade, and like no ground that training has seen."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from humoslope.registry import all_tasks, build_task
from humoslope.terrain import TerrainGridCfg, course, registry
from humoslope.terrain.grid import tile_points
from terrains.heldout import BANK, BUMP, CELL, SEED, SEGMENTS, WIDTH
from tests.terrain.ground import TRAINING

X, Y = tile_points(35.0, WIDTH, CELL)
MIDDLE = Y.shape[1] // 2
GRADES = st.floats(0.0, 40.0)
ENDS = np.cumsum([s.length for s in SEGMENTS]).tolist()
SLOPES = [(s, end - s.length, end) for s, end in zip(SEGMENTS, ENDS, strict=True)]


def heights(grade: float) -> np.ndarray:
    return registry.find("held-out-track").heights(X, Y, grade, np.random.default_rng(99))


def inside(start: float, end: float, margin: float = 0.0) -> np.ndarray:
    x = X[:, 0]
    return (x > start + margin + 1e-9) & (x < end - margin - 1e-9)


def test_the_segments_sum_to_35_metres_with_every_surface_on_a_slope() -> None:
    assert sum(segment.length for segment in SEGMENTS) == course.find("held-out-track").length == 35.0
    assert {s.surface for s in SEGMENTS if s.direction} == {"smooth", "wavy", "banked", "rough", "striped"}
    rise = sum(s.direction * s.length for s in SEGMENTS)
    assert rise == 0.0


@settings(max_examples=15)
@given(grade=GRADES)
def test_planar_segments_have_the_nominal_grade_across_their_whole_width(grade: float) -> None:
    track = heights(grade)
    planar = [(s, start, end) for s, start, end in SLOPES if s.surface == "smooth"]
    assert {segment.direction for segment, *_ in planar} == {-1, 0, 1}
    for segment, start, end in planar:
        slope = np.degrees(np.arctan(np.diff(track, axis=0) / CELL))[inside(start, end, CELL)[1:]]
        np.testing.assert_allclose(slope, segment.direction * grade, atol=1e-6)


@settings(max_examples=15)
@given(grade=GRADES)
def test_a_segment_of_any_surface_rises_and_falls_as_a_whole_by_its_grade(grade: float) -> None:
    centre = heights(grade)[:, MIDDLE]
    for segment, start, end in SLOPES:
        rise = centre[round(end / CELL)] - centre[round(start / CELL)]
        assert rise == pytest.approx(segment.direction * segment.length * np.tan(np.radians(grade)), abs=1e-9)


@settings(max_examples=15)
@given(grade=GRADES)
def test_the_ground_is_continuous_at_the_joints_and_elsewhere(grade: float) -> None:
    track = heights(grade)
    steepest = np.tan(np.radians(grade)) + 0.5  # of a rib's side; a step would be much steeper on one cell
    near_centre = np.abs(Y[0]) < 1.0
    assert (np.abs(np.diff(track, axis=0)) / CELL)[:, near_centre].max() <= steepest + 1e-6
    assert (np.abs(np.diff(track, axis=1)) / CELL).max() <= 2 * BUMP / 0.15 + 1e-6


@settings(max_examples=5)
@given(grade=GRADES)
def test_the_surfaces_are_the_same_at_every_grade(grade: float) -> None:
    slopes = np.tan(np.radians(grade)) * np.interp(
        X, [0.0, *(end for *_, end in SLOPES)], np.cumsum([0.0] + [s.direction * s.length for s in SEGMENTS])
    )
    np.testing.assert_allclose(heights(grade) - slopes, heights(0.0), atol=1e-9)


def test_each_surface_is_as_large_as_stated() -> None:
    flat = heights(0.0)
    size = {s.surface: np.abs(flat[inside(start, end)][:, MIDDLE]).max() for s, start, end in SLOPES if s.direction}
    assert size["smooth"] == size["banked"] == 0.0
    assert size["wavy"] == pytest.approx(0.04, abs=0.001)
    assert 0.02 < size["rough"] <= 0.03
    assert size["striped"] == pytest.approx(0.025)


def test_the_banked_slope_tilts_to_one_side_and_then_to_the_other() -> None:
    tilt = np.degrees(np.arctan(np.diff(heights(20.0), axis=1) / CELL))
    np.testing.assert_allclose(tilt[inside(14.5, 15.1)], BANK, atol=1e-6)
    np.testing.assert_allclose(tilt[inside(15.9, 16.5)], -BANK, atol=1e-6)


# What training has seen


@pytest.mark.parametrize("name", TRAINING)
def test_no_training_terrain_is_the_track_at_any_grade_or_seed(name: str) -> None:
    kind = registry.find(name)
    tracks = [heights(grade) for grade in (0.0, 10.0, 20.0, 30.0)]
    for seed in range(3):
        for difficulty in (0.0, 0.5, 1.0):
            drawn = kind.heights(X, Y, kind.grade_at(difficulty), np.random.default_rng((seed, 0, seed)))
            assert all(np.abs(drawn - track).max() > 0.1 for track in tracks)


@given(seed=st.integers(0, 2**31), column=st.integers(0, 50), level=st.integers(0, 30))
def test_no_seed_of_training_draws_the_bumps_of_the_track(seed: int, column: int, level: int) -> None:
    track = np.random.default_rng(SEED).uniform(-1.0, 1.0, 2000)
    training = np.random.default_rng((seed, column, level)).uniform(-1.0, 1.0, 2000)
    assert set(track).isdisjoint(training)


@pytest.mark.parametrize("name", all_tasks())
def test_no_task_trains_on_the_track(name: str) -> None:
    terrain = build_task(name).env.scene.terrain
    assert isinstance(terrain, TerrainGridCfg)
    assert set(terrain.columns) <= set(TRAINING)
