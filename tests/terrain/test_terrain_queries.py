"""Lookups read the very triangles that MuJoCo collides with."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from humoslope.terrain import Terrain, TerrainGridCfg, TerrainQueries, add_terrain
from tests.terrain.ground import TRAINING, normal

DOWN = np.array([0.0, 0.0, -1.0])


def field(heights: NDArray[np.float32], cell: float = 0.1) -> Terrain:
    """A bare height field, centred, with no tiles to speak of."""
    nx, ny = heights.shape
    return Terrain(
        heights=heights.astype(np.float32),
        cell=cell,
        origin=(-0.5 * (nx - 1) * cell, -0.5 * (ny - 1) * cell),
        tile_origin=np.zeros((1, 1, 3)),
        kind=("bare",),
        grade=np.zeros((1, 1)),
        tile_length=(nx - 1) * cell,
        tile_width=(ny - 1) * cell,
    )


def bumpy(seed: int, cell: float = 0.1) -> Terrain:
    return field(np.random.default_rng(seed).uniform(-0.2, 0.2, (41, 23)).astype(np.float32), cell)


class World:
    """MuJoCo's opinion of a terrain: where a vertical ray meets it, and with which normal."""

    def __init__(self, terrain: Terrain) -> None:
        spec = mujoco.MjSpec()
        add_terrain(spec, terrain)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self.top = float(terrain.heights.max()) + 1.0

    def drop(self, xy: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        heights, normals = np.empty(len(xy)), np.empty((len(xy), 3))
        geom = np.zeros(1, dtype=np.int32)
        for k, (x, y) in enumerate(xy.astype(np.float64)):
            start = np.array([x, y, self.top])
            distance = mujoco.mj_ray(self.model, self.data, start, DOWN, None, 1, -1, geom, normals[k])
            assert distance >= 0.0, f"the ray at {x}, {y} misses the terrain"
            heights[k] = self.top - distance
        return heights, normals


@pytest.fixture(scope="module")
def every_kind() -> Terrain:
    return TerrainGridCfg(columns=dict.fromkeys(TRAINING, 1.0), levels=4, num_columns=2 * len(TRAINING)).build()


@pytest.fixture(scope="module")
def every_kind_world(every_kind: Terrain) -> World:
    return World(every_kind)


def on_tile(terrain: Terrain, level: int, column: int, count: int) -> NDArray[np.float32]:
    rng = np.random.default_rng((level, column))
    x = terrain.tile_origin[level, column, 0] + rng.uniform(0.0, terrain.tile_length, count)
    y = terrain.tile_origin[level, column, 1] + rng.uniform(-0.5, 0.5, count) * terrain.tile_width
    return np.stack((x, y), axis=1).astype(np.float32)


@pytest.mark.parametrize("name", TRAINING)
def test_height_and_normal_on_every_kind_are_those_a_ray_finds(
    name: str, every_kind: Terrain, every_kind_world: World
) -> None:
    queries = TerrainQueries(every_kind, "cpu")
    for column in (k for k, kind in enumerate(every_kind.kind) if kind == name):
        for level in range(every_kind.grade.shape[0]):
            xy = on_tile(every_kind, level, column, 150)
            heights, normals = every_kind_world.drop(xy)
            np.testing.assert_allclose(queries.height(torch.from_numpy(xy)), heights, rtol=0, atol=1e-4)
            # Beside an edge between triangles either side's normal may be meant, so points there are left out.
            clear = np.abs(heights - queries.height(torch.from_numpy(xy)).numpy()) < 1e-5
            clear &= away_from_edges(every_kind, xy)
            np.testing.assert_allclose(normal(queries, torch.from_numpy(xy))[clear], normals[clear], atol=1e-3)


def away_from_edges(terrain: Terrain, xy: NDArray[np.float32]) -> NDArray[np.bool_]:
    u, v = ((xy - np.array(terrain.origin)) / terrain.cell % 1.0).T
    return np.minimum.reduce((u, v, 1.0 - u, 1.0 - v, np.abs(u - v))) > 0.05


def test_heights_agree_with_rays_over_the_whole_field_with_its_seams_border_and_corners(
    every_kind: Terrain, every_kind_world: World
) -> None:
    rng = np.random.default_rng(3)
    half = -np.array(every_kind.origin) - 1e-4  # a ray exactly on the rim may miss
    xy = rng.uniform(-half, half, (8000, 2))
    rim = rng.uniform(-half, half, (400, 2))
    rim[:200, 0] = half[0] * rng.choice((-1.0, 1.0), 200)
    rim[200:, 1] = half[1] * rng.choice((-1.0, 1.0), 200)
    corners = half * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    points = np.concatenate((xy, rim, corners)).astype(np.float32)
    heights, _ = every_kind_world.drop(points)
    found = TerrainQueries(every_kind, "cpu").height(torch.from_numpy(points))
    np.testing.assert_allclose(found, heights, rtol=0, atol=1e-3)


def test_a_small_sphere_centred_on_the_ground_sinks_in_by_its_radius() -> None:
    """Contacts, not only rays, use the triangles that the lookups read."""
    terrain = bumpy(5)
    spec = mujoco.MjSpec()
    add_terrain(spec, terrain)
    ball = spec.worldbody.add_body(name="ball")
    ball.add_freejoint()
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.002, 0, 0], mass=1.0)
    model = spec.compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(6)
    # In the middle of a triangle, where no other one is in reach.
    cells = rng.integers((0, 0), (40, 22), (60, 2))
    inside = np.where(rng.random(60)[:, None] < 0.5, (2 / 3, 1 / 3), (1 / 3, 2 / 3))
    xy = ((cells + inside) * terrain.cell + np.array(terrain.origin)).astype(np.float32)
    queries = TerrainQueries(terrain, "cpu")
    heights, normals = queries.height(torch.from_numpy(xy)).numpy(), normal(queries, torch.from_numpy(xy)).numpy()
    for place, height, up in zip(xy, heights, normals, strict=True):
        data.qpos[:3] = (*place, height)
        mujoco.mj_forward(model, data)
        assert data.ncon > 0
        deepest = data.contact[int(np.argmin(data.contact.dist))]
        assert deepest.dist == pytest.approx(-0.002, abs=1e-4)
        np.testing.assert_allclose(np.abs(deepest.frame[:3]), np.abs(up), atol=1e-2)


def test_flat_ground_is_a_plane_at_its_height() -> None:
    terrain = field(np.full((5, 7), 0.3, dtype=np.float32))
    world = World(terrain)
    assert world.model.geom("terrain").type[0] == mujoco.mjtGeom.mjGEOM_PLANE
    heights, normals = world.drop(np.array([[0.0, 0.0], [0.15, -0.22]], dtype=np.float32))
    np.testing.assert_allclose(heights, 0.3, atol=1e-6)
    np.testing.assert_allclose(normals, [[0, 0, 1]] * 2, atol=1e-9)


def slope_normal(queries: TerrainQueries, xy: torch.Tensor, radius: float = 0.4) -> torch.Tensor:
    return queries.slope_normal(queries.height(queries.around(xy, radius)), radius)


@settings(deadline=None)
@given(grade=st.floats(-45, 45), bank=st.floats(-30, 30), cell=st.sampled_from((0.05, 0.1, 0.2)))
def test_a_plane_has_one_normal_and_one_grade_everywhere(grade: float, bank: float, cell: float) -> None:
    a, b = math.tan(math.radians(grade)), math.tan(math.radians(bank))
    x, y = np.meshgrid(np.arange(30) * cell, np.arange(30) * cell, indexing="ij")
    queries = TerrainQueries(field(a * x + b * y, cell), "cpu")
    xy = (torch.rand((64, 2), generator=torch.Generator().manual_seed(0)) - 0.5) * 20 * cell
    true = torch.tensor((-a, -b, 1.0)) / math.sqrt(a * a + b * b + 1.0)
    torch.testing.assert_close(slope_normal(queries, xy, 4 * cell), true.expand(64, 3), atol=1e-3, rtol=0)


@settings(max_examples=30, deadline=None)
@given(lift=st.floats(-100, 100), seed=st.integers(0, 9))
def test_lifting_the_ground_lifts_heights_and_leaves_normals(lift: float, seed: int) -> None:
    low = bumpy(seed)
    high = field(low.heights + np.float32(lift))
    xy = torch.from_numpy(np.random.default_rng(seed).uniform(-0.9, 0.9, (50, 2)).astype(np.float32))
    below, above = TerrainQueries(low, "cpu"), TerrainQueries(high, "cpu")
    torch.testing.assert_close(above.height(xy), below.height(xy) + lift, atol=1e-4, rtol=0)
    torch.testing.assert_close(slope_normal(above, xy), slope_normal(below, xy), atol=1e-3, rtol=0)


@settings(max_examples=30, deadline=None)
@given(one=st.integers(0, 99), other=st.integers(0, 99))
def test_the_height_of_a_sum_of_grounds_is_the_sum_of_their_heights(one: int, other: int) -> None:
    a, b = bumpy(one), bumpy(other)
    xy = torch.from_numpy(np.random.default_rng(one).uniform(-2.5, 2.5, (50, 2)).astype(np.float32))
    total = TerrainQueries(field(a.heights + b.heights), "cpu").height(xy)
    parts = TerrainQueries(a, "cpu").height(xy) + TerrainQueries(b, "cpu").height(xy)
    torch.testing.assert_close(total, parts, atol=1e-5, rtol=0)


def test_points_beyond_the_field_read_its_rim_and_a_diverged_world_reads_nan() -> None:
    terrain = bumpy(1)
    queries = TerrainQueries(terrain, "cpu")
    far = torch.tensor([[-1e9, -1e9], [1e9, 1e9], [math.inf, -math.inf]])
    rim = torch.from_numpy(terrain.heights[[0, -1, -1], [0, -1, 0]])
    torch.testing.assert_close(queries.height(far), rim)
    lost = torch.tensor([[math.nan, 0.0], [0.0, math.nan]])
    assert queries.height(lost).isnan().all()


def test_lookups_keep_the_shape_of_what_they_are_asked() -> None:
    queries = TerrainQueries(bumpy(2), "cpu")
    xy = torch.zeros(3, 4, 5, 2)
    assert queries.height(xy).shape == (3, 4, 5)
    assert slope_normal(queries, xy).shape == (3, 4, 5, 3)
    assert queries.height(torch.zeros(2)).shape == ()
