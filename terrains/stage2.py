"""Terrain of Stage II: slope tracks."""

from __future__ import annotations

from humoslope.terrain import TerrainGridCfg


def stage2() -> TerrainGridCfg:
    """Half tracks of two ramps, up and down in either order, with all five surfaces; hillsides for all directions.

    Tiles are longer than those of Stage I, so that a robot meets every transition within an episode. Layout and seed
    differ from those of the held-out track.
    """
    return TerrainGridCfg(
        columns={
            "compound": 0.5,
            "hillside": 0.2,
            "rough-hillside": 0.05,
            "ramp-up": 0.05,
            "ramp-down": 0.05,
            "banked": 0.05,
            "rough": 0.05,
            "flat": 0.05,
        },
        tile_length=12.0,
        tile_width=8.0,
        seed=2,
    )
