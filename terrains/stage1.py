"""Terrain of Stage I: mixed slopes."""

from __future__ import annotations

from humoslope.terrain import TerrainGridCfg


def stage1() -> TerrainGridCfg:
    """Ramps up and ramps down, a quarter each; the rest is flat, wavy and rough ground and rough slopes.

    Banked and striped ground is left to Stage II, since a column, a twentieth, would cost as much as a rough slope.
    """
    return TerrainGridCfg(
        columns={
            "flat": 0.15,
            "ramp-up": 0.25,
            "ramp-down": 0.25,
            "rough-ramp-up": 0.075,
            "rough-ramp-down": 0.075,
            "wave": 0.1,
            "rough": 0.1,
        }
    )
