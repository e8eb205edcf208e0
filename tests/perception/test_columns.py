"""Columns around a body against every triangle of the ground."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.mdp.voxels import BOX
from humoslope.perception.columns import ColumnGrid, column_heights
from humoslope.slope import quaternion
from humoslope.terrain import TerrainQueries
from humoslope.terrain.grid import Terrain

CELL, HALF = 0.1, 2.4
GRID = ColumnGrid(**BOX, cell=0.2)
AXIS = np.arange(-24, 25) * CELL


def terrain(heights: np.ndarray) -> Terrain:
    return Terrain(
        heights=heights.astype(np.float32),
        cell=CELL,
        origin=(-HALF, -HALF),
        tile_origin=np.array([[[-HALF, 0.0, 0.0]]]),
        kind=("made up",),
        grade=np.zeros((1, 1)),
        tile_length=2.0 * HALF,
        tile_width=2.0 * HALF,
    )


def ground(slope: float, uphill: float, bumps: float, edge: bool, seed: int) -> Terrain:
    """A plane, with bumps at every vertex, or one that begins below the robot."""
    x, y = np.meshgrid(AXIS, AXIS, indexing="ij")
    along = x * math.cos(math.radians(uphill)) + y * math.sin(math.radians(uphill))
    heights = math.tan(math.radians(slope)) * (np.maximum(along, 0.0) if edge else along)
    return terrain(heights + np.random.default_rng(seed).uniform(-bumps, bumps, heights.shape))


def rotation(roll: float, pitch: float, yaw: float) -> torch.Tensor:
    tilt = quaternion.from_rotation_vector(torch.tensor([math.radians(roll), math.radians(pitch), 0.0]))
    turn = quaternion.matrix(quaternion.from_yaw(torch.tensor(math.radians(yaw))))
    return (turn @ quaternion.matrix(tilt))[None]


def lookup(terrain: Terrain, position: torch.Tensor, turned: torch.Tensor, steps: int = 3) -> np.ndarray:
    queries = TerrainQueries(terrain, "cpu")
    below = queries.height(position[:, :2])
    normal = queries.slope_normal(queries.height(queries.around(position[:, :2])))
    offsets = GRID.offsets(torch.device("cpu"))
    found = column_heights(
        position, turned, offsets, below, normal, lambda places: queries.height(places.movedim(0, -1)), steps
    )
    return found[0].double().numpy()


def brute_force(terrain: Terrain, position: torch.Tensor, turned: torch.Tensor) -> np.ndarray:
    """The highest crossing of each column's line with any triangle, NaN if there is none."""
    x, y = np.meshgrid(AXIS, AXIS, indexing="ij")
    vertices = np.stack([x, y, terrain.heights.astype(np.float64)], axis=2)
    a, b, c, d = vertices[:-1, :-1], vertices[1:, :-1], vertices[1:, 1:], vertices[:-1, 1:]
    triangles = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3, 3)
    first, edge_1, edge_2 = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    frame = turned[0].double().numpy()
    flat = np.vstack([GRID.offsets(torch.device("cpu")).double().numpy(), np.zeros(GRID.side**2)])
    starts, up = (frame @ flat).T + position[0].double().numpy(), frame[:, 2]
    # start + t up = first + u edge_1 + v edge_2, by Cramer's rule for all triangles at once.
    across = np.cross(up, edge_2)
    scale = (edge_1 * across).sum(axis=1)
    found = np.full(len(starts), -np.inf)
    for i, start in enumerate(starts):
        to = start - first
        u = (to * across).sum(axis=1) / scale
        turned_to = np.cross(to, edge_1)
        v = turned_to @ up / scale
        t = (edge_2 * turned_to).sum(axis=1) / scale
        inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9)
        found[i] = max(t[inside], default=-np.inf)
    return found


tilts = st.floats(-15.0, 15.0)
headings = st.floats(-180.0, 180.0)


@settings(max_examples=12)
@given(slope=st.floats(-35.0, 35.0), uphill=headings, roll=tilts, pitch=tilts, yaw=headings)
def test_on_a_plane_the_columns_meet_it_at_once_whatever_the_heading_and_the_tilt(slope, uphill, roll, pitch, yaw):
    there, turned = ground(slope, uphill, 0.0, False, 0), rotation(roll, pitch, yaw)
    position = torch.tensor([[0.13, -0.07, 0.8]])
    assert lookup(there, position, turned, 0) == pytest.approx(brute_force(there, position, turned), abs=2e-5)
    assert lookup(there, position, turned) == pytest.approx(brute_force(there, position, turned), abs=2e-5)


@settings(max_examples=12)
@given(slope=st.floats(-30.0, 30.0), uphill=headings, roll=tilts, pitch=tilts, yaw=headings, seed=st.integers(0, 99))
def test_on_rough_slopes_three_steps_are_within_a_centimetre_of_the_triangles(slope, uphill, roll, pitch, yaw, seed):
    there, turned = ground(slope, uphill, 0.03, False, seed), rotation(roll, pitch, yaw)
    position = torch.tensor([[0.0, 0.0, 0.8]])
    off = np.abs(lookup(there, position, turned) - brute_force(there, position, turned))
    assert off.max() < 0.01  # a fifth of the smallest cell
    assert np.median(off) < 1e-4


@pytest.mark.parametrize("slope", [-30.0, 30.0])
def test_at_the_foot_of_a_ramp_too(slope):
    there, position = ground(slope, 0.0, 0.0, True, 0), torch.tensor([[-0.1, 0.0, 0.8]])
    for turned in (rotation(0.0, 15.0, 0.0), rotation(10.0, -15.0, 40.0)):
        off = np.abs(lookup(there, position, turned) - brute_force(there, position, turned))
        assert off.max() < 0.005


def test_a_robot_that_has_fallen_over_gets_finite_heights():
    there = ground(10.0, 0.0, 0.03, False, 0)
    for roll, pitch in ((90.0, 0.0), (0.0, -90.0), (180.0, 0.0)):
        assert np.isfinite(lookup(there, torch.tensor([[0.0, 0.0, 0.3]]), rotation(roll, pitch, 0.0))).all()


def test_a_grid_is_as_large_as_its_box_and_its_cell_say():
    full, reduced = ColumnGrid(**BOX, cell=0.05), ColumnGrid(**BOX, cell=0.1)
    assert (full.side, full.levels, str(full)) == (32, 40, "32 x 32 x 40 of 5 cm")
    assert (reduced.side, reduced.levels, str(reduced)) == (16, 20, "16 x 16 x 20 of 10 cm")
    offsets = full.offsets(torch.device("cpu"))
    assert offsets[:, 0].tolist() == pytest.approx([-0.775, -0.775])
    assert offsets[:, 1].tolist() == pytest.approx([-0.775, -0.725])  # row by row, from the right
    assert offsets[:, -1].tolist() == pytest.approx([0.775, 0.775])


@pytest.mark.parametrize("cell", [0.0, 0.3, 0.07, 5.0])
def test_a_cell_that_does_not_divide_the_box_is_refused(cell):
    with pytest.raises(UserError, match="must divide its box"):
        ColumnGrid(**BOX, cell=cell)
