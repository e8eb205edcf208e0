"""Terrain as a MuJoCo geom."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from humoslope.terrain.grid import Terrain

TERRAIN_GEOM = "terrain"
"""Name of the geom that is the ground."""
BASE_THICKNESS = 1.0
"""Solid ground below the lowest height, m; a thin base lets a fast foot pass through."""


def add_terrain(spec: mujoco.MjSpec, terrain: Terrain) -> None:
    """Adds the terrain to a spec as one geom called `TERRAIN_GEOM`, with friction 1 and contact dimension 3.

    The geom is a height field of the same name, or a plane, whose contacts cost less, if the ground is flat everywhere.
    MuJoCo keeps heights as float32 fractions of their range: over a range of 10 m they are within a micrometre of the
    float32 heights that `TerrainQueries` reads.

    Args:
        spec: Spec to add to.
        terrain: Terrain in the spec's world frame.
    """
    contact = {"contype": 1, "conaffinity": 1, "condim": 3, "priority": 0, "friction": [1.0, 0.005, 0.0001]}
    nx, ny = terrain.heights.shape
    half_x, half_y = 0.5 * (nx - 1) * terrain.cell, 0.5 * (ny - 1) * terrain.cell
    low = float(terrain.heights.min())
    centre = [terrain.origin[0] + half_x, terrain.origin[1] + half_y, low]
    if terrain.is_flat:
        size = [half_x, half_y, 1.0]
        spec.worldbody.add_geom(name=TERRAIN_GEOM, type=mujoco.mjtGeom.mjGEOM_PLANE, size=size, pos=centre, **contact)
        return
    span = float(terrain.heights.max()) - low
    fractions = ((terrain.heights.astype(np.float64) - low) / span).astype(np.float32)
    # Rows run along y, columns along x.
    add_height_field(spec, TERRAIN_GEOM, fractions.T, (half_x, half_y, span, BASE_THICKNESS))
    spec.worldbody.add_geom(
        name=TERRAIN_GEOM, type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname=TERRAIN_GEOM, pos=centre, **contact
    )


def add_height_field(
    spec: mujoco.MjSpec, name: str, fractions: NDArray[np.float32], size: tuple[float, float, float, float]
) -> None:
    """Adds a height field to a spec, as a file in memory: MuJoCo would convert a million `userdata` one by one.

    Args:
        fractions: [rows along y, columns along x] heights, from 0 to 1 of `size[2]`.
        size: Half extents along x and y, height of 1, and thickness of the base, m.
    """
    file = np.array(fractions.shape, dtype=np.int32).tobytes() + fractions.astype(np.float32).tobytes()
    spec.assets = spec.assets | {f"{name}.hfield": file}
    spec.add_hfield(name=name, size=list(size), file=f"{name}.hfield")
