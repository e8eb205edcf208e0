"""The ground of a rollout as triangles, split along the same diagonals as those MuJoCo collides with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from humoslope.replay.robot import Shape
from humoslope.replay.rollout import Rollout

MOSS, PALE = (118, 132, 108), (130, 144, 119)
"""Colours of the chequers, 1 m wide, by which one sees how fast the robot is."""


def ground_shape(rollout: Rollout) -> Shape:
    """The whole height field, in the world frame."""
    heights, terrain = rollout.terrain_heights, rollout.header["terrain"]
    cell = float(terrain["cell"])
    nx, ny = heights.shape
    x = terrain["origin"][0] + cell * np.arange(nx)
    y = terrain["origin"][1] + cell * np.arange(ny)
    grid_x, grid_y = np.meshgrid(x, y, indexing="ij")
    slope_x, slope_y = np.gradient(heights, cell)
    normals = np.stack([-slope_x, -slope_y, np.ones_like(heights)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    corner = (np.arange(nx - 1)[:, None] * ny + np.arange(ny - 1)).ravel()
    far = corner + ny + 1
    triangles = np.stack([corner, corner + ny, far, corner, far, corner + 1], axis=1).reshape(-1, 3)
    return Shape(
        vertices=np.stack([grid_x, grid_y, heights], axis=-1).reshape(-1, 3).astype(np.float32),
        normals=normals.reshape(-1, 3).astype(np.float32),
        triangles=triangles.astype(np.int32),
        colours=chequers(grid_x.ravel(), grid_y.ravel()),
    )


def chequers(x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Colour [..., 3] of the ground at each place."""
    odd = (np.floor(x) + np.floor(y)).astype(np.int64) % 2
    return np.array((MOSS, PALE), np.uint8)[odd]
