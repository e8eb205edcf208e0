"""The mixed slopes of Stage I."""

from __future__ import annotations

from humoslope.terrain import TerrainGridCfg


def stage1() -> TerrainGridCfg:
    """A quarter each of ramps up and down; the rest is flat, wavy and rough ground and rough slopes.

    Banked and striped ground is left to Stage II: as a column is a twentieth, it would cost as much as a rough slope.
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
