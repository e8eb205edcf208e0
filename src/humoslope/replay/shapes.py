"""Triangle meshes for all viewers, and the mesh of the ground of a rollout."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from humoslope.replay.rollout import Rollout


@dataclass(frozen=True)
class Shape:
    """A triangle mesh.

    Attributes:
        vertices: [V, 3] positions, m.
        normals: [V, 3] unit vectors.
        triangles: [F, 3] indices of vertices.
        colours: [V, 3] red, green, blue in 0..255.
    """

    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    triangles: NDArray[np.int32]
    colours: NDArray[np.uint8]

    def moved(self, rotation: NDArray[np.floating], position: NDArray[np.floating]) -> Shape:
        """Returns the shape rotated by `rotation` [3, 3], then translated by `position` [3]."""
        turn = rotation.T.astype(np.float32)
        vertices = self.vertices @ turn + position.astype(np.float32)
        return Shape(vertices, self.normals @ turn, self.triangles, self.colours)


def joined(shapes: Sequence[Shape]) -> Shape:
    """Returns all shapes as one."""
    first = np.cumsum([0, *(len(shape.vertices) for shape in shapes[:-1])])
    return Shape(
        vertices=np.concatenate([shape.vertices for shape in shapes]),
        normals=np.concatenate([shape.normals for shape in shapes]),
        triangles=np.concatenate([shape.triangles + i for shape, i in zip(shapes, first, strict=True)]).astype(
            np.int32
        ),
        colours=np.concatenate([shape.colours for shape in shapes]),
    )


MOSS, PALE = (118, 132, 108), (130, 144, 119)
"""Colours of the chequers, 1 m wide, that make the robot's speed visible."""
EARTH = (96, 88, 78)
"""Colour of the sides of the slab."""
THICKNESS = 0.5
"""Thickness of the slab that represents the ground, m."""


def ground_shape(rollout: Rollout) -> Shape:
    """Returns the robot's tile in the world frame.

    The level border around it is left out: beside a descent it would be a wall that hides the robot.
    """
    terrain = rollout.header["terrain"]
    cell, (start_x, middle_y) = float(terrain["cell"]), terrain["tile_origin"][:2]
    first = round((start_x - terrain["origin"][0]) / cell)
    right = round((middle_y - 0.5 * terrain["tile_width"] - terrain["origin"][1]) / cell)
    ahead, across = (round(terrain[name] / cell) + 1 for name in ("tile_length", "tile_width"))
    heights = rollout.terrain_heights[first : first + ahead, right : right + across]
    nx, ny = heights.shape
    x = terrain["origin"][0] + cell * (first + np.arange(nx))
    y = terrain["origin"][1] + cell * (right + np.arange(ny))
    top = surface(x, y, heights, (start_x, middle_y))
    number = np.arange(nx * ny).reshape(nx, ny)
    right_edge, left_edge = number[:, 0], number[::-1, -1]
    front, back = number[-1, :], number[0, ::-1]
    walls = [(right_edge, (0, -1)), (front, (1, 0)), (left_edge, (0, 1)), (back, (-1, 0))]
    return joined([top, *(_wall(top.vertices[edge], normal) for edge, normal in walls)])


def surface(
    x: NDArray[np.floating], y: NDArray[np.floating], heights: NDArray[np.floating], corner: tuple[float, float]
) -> Shape:
    """Returns ground with these heights [nx, ny] over evenly spaced places x [nx] and y [ny], m.

    Args:
        corner: Place where a chequer begins, m.
    """
    nx, ny = heights.shape
    cell = float(x[1] - x[0])
    grid_x, grid_y = np.meshgrid(x, y, indexing="ij")
    slope_x, slope_y = np.gradient(heights, cell)
    normals = np.stack([-slope_x, -slope_y, np.ones_like(heights)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    low = (np.arange(nx - 1)[:, None] * ny + np.arange(ny - 1)).ravel()
    far = low + ny + 1
    triangles = np.stack([low, low + ny, far, low, far, low + 1], axis=1).reshape(-1, 3)
    return Shape(
        vertices=np.stack([grid_x, grid_y, heights], axis=-1).reshape(-1, 3).astype(np.float32),
        normals=normals.reshape(-1, 3).astype(np.float32),
        triangles=triangles.astype(np.int32),
        # A vertex has the colour of the cell that begins there, so that cells can be drawn in one colour each.
        colours=chequers(grid_x.ravel() + 0.5 * cell - corner[0], grid_y.ravel() + 0.5 * cell - corner[1]),
    )


def _wall(edge: NDArray[np.float32], normal: tuple[int, int]) -> Shape:
    """Returns the side of the slab below an edge [K, 3] of the tile; edges run counter-clockwise."""
    below = edge - np.array((0.0, 0.0, THICKNESS), np.float32)
    first = np.arange(len(edge) - 1)
    under = first + len(edge)
    triangles = np.stack([under, under + 1, first + 1, under, first + 1, first], axis=1).reshape(-1, 3)
    return Shape(
        vertices=np.concatenate([edge, below]),
        normals=np.tile(np.array((*normal, 0), np.float32), (2 * len(edge), 1)),
        triangles=triangles.astype(np.int32),
        colours=np.tile(np.array(EARTH, np.uint8), (2 * len(edge), 1)),
    )


def chequers(x: NDArray[np.floating], y: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Returns the colour [..., 3] of the ground at each position."""
    odd = (np.floor(x) + np.floor(y)).astype(np.int64) % 2
    return np.array((MOSS, PALE), np.uint8)[odd]
