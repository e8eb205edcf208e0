"""A triangle mesh as every viewer takes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Shape:
    """A triangle mesh.

    Attributes:
        vertices, normals: [V, 3] m; unit vectors.
        triangles: [F, 3] indices of vertices.
        colours: [V, 3] in 0..255.
    """

    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    triangles: NDArray[np.int32]
    colours: NDArray[np.uint8]

    def moved(self, rotation: NDArray[np.floating], position: NDArray[np.floating]) -> Shape:
        """The shape turned by `rotation` [3, 3], then shifted by `position` [3]."""
        turn = rotation.T.astype(np.float32)
        vertices = self.vertices @ turn + position.astype(np.float32)
        return Shape(vertices, self.normals @ turn, self.triangles, self.colours)


def joined(shapes: Sequence[Shape]) -> Shape:
    """All shapes as one."""
    first = np.cumsum([0, *(len(shape.vertices) for shape in shapes[:-1])])
    return Shape(
        vertices=np.concatenate([shape.vertices for shape in shapes]),
        normals=np.concatenate([shape.normals for shape in shapes]),
        triangles=np.concatenate([shape.triangles + i for shape, i in zip(shapes, first, strict=True)]).astype(
            np.int32
        ),
        colours=np.concatenate([shape.colours for shape in shapes]),
    )
