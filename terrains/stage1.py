"""Terrain of Stage I: mixed slopes."""

from __future__ import annotations

from humoslope.terrain import TerrainGridCfg


def stage1() -> TerrainGridCfg:
    """Hillsides for all directions, more than half; ramps up and down; flat, wavy and rough ground; and rough slopes.

    Banked and striped ground is left to Stage II, since a column, a twentieth, would cost as much as a rough slope.
    """
    return TerrainGridCfg(
        columns={
            "hillside": 0.4,
            "rough-hillside": 0.15,
            "flat": 0.05,
            "ramp-up": 0.1,
            "ramp-down": 0.1,
            "rough-ramp-up": 0.05,
            "rough-ramp-down": 0.05,
            "wave": 0.05,
            "rough": 0.05,
        },
        tile_width=8.0,
    )
