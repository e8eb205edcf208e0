"""The PCA terrain descriptor of the paper's section 3.2."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from humoslope.slope.descriptor import LEAST_SPREAD, STEEPEST, phi5, terrain_descriptor

DEAD_BAND = math.radians(3.0)
AXIS = 0.2 * (torch.arange(7, dtype=torch.float64) - 3.0)
GRID = torch.cartesian_prod(AXIS, AXIS)  # [49, 2] forward, left
EVERYWHERE = torch.ones(49, dtype=torch.bool)

slopes = st.floats(-50.0, 50.0)
headings = st.floats(-180.0, 180.0)
lifts = st.floats(-100.0, 100.0)
seeds = st.integers(0, 2**32 - 1)


def plane(ahead: float, left: float = 0.0, lift: float = 0.0) -> torch.Tensor:
    """Points [49, 3] of the plane that rises with these tangents ahead and to the left."""
    return torch.cat([GRID, (GRID @ torch.tensor([ahead, left], dtype=torch.float64) + lift)[:, None]], dim=1)


def incline(slope: float, uphill: float, lift: float = 0.0) -> torch.Tensor:
    """Points of the plane that rises by `slope` degrees towards `uphill` degrees, seen from the robot."""
    steep, way = math.tan(math.radians(slope)), math.radians(uphill)
    return plane(steep * math.cos(way), steep * math.sin(way), lift)


def noisy(points: torch.Tensor, noise: float, keep: float, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """The points with noise in their heights, m, and a mask that holds at a share `keep` of them."""
    rng = np.random.default_rng(seed)
    rough = points.clone()
    rough[:, 2] += noise * torch.from_numpy(rng.standard_normal(len(points)))
    return rough, torch.from_numpy(rng.random(len(points)) < keep)


def by_eigh(points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Normal of the points by `torch.linalg.eigh`, and eigenvalues as shares of the variance, in float64."""
    centred = points.double() - points.double().mean(dim=0)
    values, vectors = torch.linalg.eigh(centred.T @ centred)
    normal = vectors[:, 0]
    return normal * normal[2].sign(), values / values.sum()


def angle(a: torch.Tensor, b: torch.Tensor) -> float:
    """Between two unit vectors, rad; exact for small ones."""
    return torch.linalg.cross(a.double(), b.double()).norm().clamp(max=1.0).asin().item()


def describes_level_ground_and_says_that_it_knows_nothing(points: torch.Tensor, valid: torch.Tensor) -> bool:
    d = terrain_descriptor(points, valid, DEAD_BAND)
    level = d.normal.tolist() == [0.0, 0.0, 1.0] and phi5(d).tolist() == [0.0] * 5
    return level and not d.valid


# What it reads


@given(slope=slopes, uphill=headings, lift=lifts)
def test_descriptor_reads_a_plane_at_any_heading_and_height(slope, uphill, lift):
    points = incline(slope, uphill, lift)
    d = terrain_descriptor(points, EVERYWHERE, DEAD_BAND)
    steep, way = math.tan(math.radians(slope)), math.radians(uphill)
    assert d.valid
    assert d.slope.item() == pytest.approx(math.atan(steep * math.cos(way)), abs=1e-9)
    assert d.bank.item() == pytest.approx(math.atan(steep * math.sin(way)), abs=1e-9)
    # float32 holds a height of 100 m to 8e-6 m.
    single = terrain_descriptor(points.float(), EVERYWHERE, DEAD_BAND)
    assert single.valid
    assert single.slope.dtype == torch.float32
    assert angle(single.normal, d.normal) < 2e-5


@settings(max_examples=300)
@given(
    slope=slopes,
    uphill=headings,
    lift=lifts,
    noise=st.sampled_from([0.0, 1e-6, 1e-3, 0.03, 0.1]),
    keep=st.sampled_from([1.0, 0.7, 0.3, 0.1]),
    seed=seeds,
)
def test_the_normal_is_the_least_eigenvector_of_the_valid_points_alone(slope, uphill, lift, noise, keep, seed):
    points, valid = noisy(incline(slope, uphill, lift), noise, keep, seed)
    assume(valid.sum() >= 3)
    normal, share = by_eigh(points[valid])
    spread = (share[1] - share[0]) * (share[2] - share[0])
    # Close to the two limits rounding decides; it is different for the points of float32.
    assume(abs(spread - LEAST_SPREAD) > 1e-4)
    assume(abs(normal[2] - math.cos(STEEPEST)) > 1e-2)
    unseen = points.masked_fill(~valid[:, None], math.nan)
    d = terrain_descriptor(unseen, valid, DEAD_BAND)
    assert d.valid == (spread > LEAST_SPREAD) & (normal[2] > math.cos(STEEPEST))
    if d.valid:
        assert angle(d.normal, normal) < 1e-6
        assert d.slope == pytest.approx(math.atan2(-d.normal[0], d.normal[2]), abs=1e-12)
        assert d.bank == pytest.approx(math.atan2(-d.normal[1], d.normal[2]), abs=1e-12)
        single = terrain_descriptor(unseen.float(), valid, DEAD_BAND)
        exact, _ = by_eigh(unseen.float()[valid])
        assert single.valid
        assert angle(single.normal, exact) < (1e-6 if keep > 0.5 else 2e-3)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_the_size_of_the_patch_does_not_matter(size):
    points, valid = noisy(incline(25.0, 40.0), 0.03, 0.7, 0)
    here, there = (terrain_descriptor(p.float(), valid, DEAD_BAND) for p in (points, size * points))
    torch.testing.assert_close(phi5(there), phi5(here), atol=1e-6, rtol=0)
    assert there.valid


def test_noise_perpendicular_to_a_steep_slope_does_not_flatten_it_as_least_squares_in_height_would():
    # Total least squares is symmetric about the plane: points mirrored in it give the same plane.
    points = incline(50.0, 0.0)
    normal = torch.tensor([-math.sin(math.radians(50.0)), 0.0, math.cos(math.radians(50.0))], dtype=torch.float64)
    off = torch.from_numpy(np.random.default_rng(0).standard_normal(49))[:, None]
    pairs = torch.cat([points + 0.1 * off * normal, points - 0.1 * off * normal])
    d = terrain_descriptor(pairs, torch.ones(98, dtype=torch.bool), DEAD_BAND)
    assert d.slope.item() == pytest.approx(math.radians(50.0), abs=1e-9)


@given(slope=st.floats(0.1, 50.0), seed=seeds)
def test_a_robot_that_turns_round_sees_the_slope_and_the_bank_turned_round(slope, seed):
    points, valid = noisy(incline(slope, np.random.default_rng(seed).uniform(-180.0, 180.0)), 0.02, 0.8, seed)
    turned = points * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)
    ahead, back = (terrain_descriptor(p, valid, DEAD_BAND) for p in (points, turned))
    assert ahead.valid
    torch.testing.assert_close(back.slope, -ahead.slope, atol=1e-9, rtol=0)
    torch.testing.assert_close(back.bank, -ahead.bank, atol=1e-9, rtol=0)
    assert back.up == ahead.down
    assert back.down == ahead.up


@pytest.mark.parametrize(
    ("degrees", "up", "down"), [(3.1, 1, 0), (2.9, 0, 0), (0.0, 0, 0), (-2.9, 0, 0), (-3.1, 0, 1), (40.0, 1, 0)]
)
def test_within_the_dead_band_the_ground_goes_neither_up_nor_down(degrees, up, down):
    slope = math.radians(degrees)
    d = terrain_descriptor(plane(math.tan(slope), 0.2), EVERYWHERE, DEAD_BAND)
    expected = torch.tensor([slope, math.atan(0.2), abs(slope), up, down], dtype=torch.float64)
    torch.testing.assert_close(phi5(d), expected, atol=1e-9, rtol=0)


@given(seed=seeds)
def test_every_world_is_described_by_its_own_points(seed):
    rng = np.random.default_rng(seed)
    patches = [
        noisy(incline(*rng.uniform((-50.0, -180.0), (50.0, 180.0))), 0.03, rng.choice([0.0, 0.05, 0.6, 1.0]), seed + i)
        for i in range(6)
    ]
    points, valid = (torch.stack(parts) for parts in zip(*patches, strict=True))
    together = terrain_descriptor(points.view(2, 3, 49, 3), valid.view(2, 3, 49), DEAD_BAND)
    for i, (p, v) in enumerate(patches):
        alone = terrain_descriptor(p, v, DEAD_BAND)
        for whole, part in zip(together, alone, strict=True):
            torch.testing.assert_close(whole.flatten(0, 1)[i], part, atol=1e-9, rtol=0)


# Where there is no plane

few = st.lists(st.integers(0, 48), max_size=2, unique=True)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@given(slope=slopes, uphill=headings, lift=lifts, chosen=few)
def test_fewer_than_three_points_have_no_plane(dtype, slope, uphill, lift, chosen):
    valid = torch.zeros(49, dtype=torch.bool)
    valid[chosen] = True
    points = incline(slope, uphill, lift).to(dtype).masked_fill(~valid[:, None], math.inf)
    assert describes_level_ground_and_says_that_it_knows_nothing(points, valid)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@given(start=st.tuples(lifts, lifts, lifts), seed=seeds)
def test_points_on_a_line_have_no_plane(dtype, start, seed):
    rng = np.random.default_rng(seed)
    along = torch.from_numpy(rng.uniform(-1.0, 1.0, (20, 1)))
    points = torch.tensor(start, dtype=torch.float64) + along * torch.from_numpy(rng.standard_normal(3))
    assume(along.std() * points.std(dim=0).max() > 0.01)
    every = torch.ones(20, dtype=torch.bool)
    assert describes_level_ground_and_says_that_it_knows_nothing(points.to(dtype), every)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_one_place_many_times_has_no_plane(dtype):
    points = torch.tensor([0.1, 0.2, 97.3], dtype=dtype).expand(49, 3)
    assert describes_level_ground_and_says_that_it_knows_nothing(points, EVERYWHERE)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_points_spread_alike_in_all_directions_have_no_plane(dtype):
    corners = torch.cartesian_prod(*[torch.tensor([-1.0, 1.0], dtype=dtype)] * 3)
    assert describes_level_ground_and_says_that_it_knows_nothing(corners, torch.ones(8, dtype=torch.bool))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@given(uphill=headings, lift=lifts, seed=seeds)
def test_a_vertical_plane_is_not_ground(dtype, uphill, lift, seed):
    # As read by a single row of points over bumps.
    way, rng = math.radians(uphill), np.random.default_rng(seed)
    along, height = torch.from_numpy(rng.uniform(-0.6, 0.6, (2, 30)))
    points = torch.stack([along * math.cos(way), along * math.sin(way), height + lift], dim=1)
    every = torch.ones(30, dtype=torch.bool)
    assert describes_level_ground_and_says_that_it_knows_nothing(points.to(dtype), every)


def test_a_valid_point_without_a_height_spoils_its_own_world_alone():
    points = torch.stack([incline(20.0, 0.0)] * 2)
    points[0, 7, 2] = math.nan
    d = terrain_descriptor(points, EVERYWHERE.expand(2, 49), DEAD_BAND)
    assert d.valid.tolist() == [False, True]
    torch.testing.assert_close(d.slope, torch.tensor([0.0, math.radians(20.0)], dtype=torch.float64))
