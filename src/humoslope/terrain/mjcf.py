"""The terrain as a MuJoCo geom."""

from __future__ import annotations

import mujoco
import numpy as np

from humoslope.terrain.grid import Terrain

GEOM_NAME = "terrain"
BASE_THICKNESS = 1.0
"""Solid ground below the lowest height, m; a thin base lets a fast foot pass through."""


def add_terrain(spec: mujoco.MjSpec, terrain: Terrain, *, allow_plane: bool = True) -> None:
    """Adds the terrain to a spec as one geom named "terrain", with friction 1 and contact dimension 3.

    MuJoCo keeps heights as float32 fractions of their range: over a range of 10 m they are within a micrometre of the
    float32 heights that `TerrainQueries` reads.

    Args:
        spec: Gets the geom, and a height field of the same name.
        terrain: Its world frame becomes the spec's.
        allow_plane: Whether ground that is flat everywhere may be a plane, whose contacts cost less.
    """
    contact = {"contype": 1, "conaffinity": 1, "condim": 3, "priority": 0, "friction": [1.0, 0.005, 0.0001]}
    nx, ny = terrain.heights.shape
    half_x, half_y = 0.5 * (nx - 1) * terrain.cell, 0.5 * (ny - 1) * terrain.cell
    low = float(terrain.heights.min())
    centre = [terrain.origin[0] + half_x, terrain.origin[1] + half_y, low]
    if allow_plane and terrain.is_flat:
        size = [half_x, half_y, 1.0]
        spec.worldbody.add_geom(name=GEOM_NAME, type=mujoco.mjtGeom.mjGEOM_PLANE, size=size, pos=centre, **contact)
        return
    # MuJoCo wants a positive range even where all heights are the same.
    span = float(terrain.heights.max()) - low or 0.01
    fractions = (terrain.heights.astype(np.float64) - low) / span
    spec.add_hfield(
        name=GEOM_NAME,
        size=[half_x, half_y, span, BASE_THICKNESS],
        nrow=ny,  # rows run along y, columns along x
        ncol=nx,
        userdata=fractions.T.ravel().astype(np.float32),
    )
    spec.worldbody.add_geom(
        name=GEOM_NAME, type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname=GEOM_NAME, pos=centre, **contact
    )
