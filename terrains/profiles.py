"""Profiles of the ground along the direction of travel, from height 0, and planes; lengths in m, grades in degrees."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from humoslope.errors import UserError
from humoslope.terrain.registry import Array

APPROACH = 1.5
"""Length of the flat ground before a ramp, where robots start, m."""
RUN_OUT = 1.5
"""Length of the flat ground after a ramp, m."""
LEAST_SLOPE = 1.0
"""Shortest slope, m: two to three steps. On a shorter one no robot ever walks on the slope alone. Ours."""


class Segment(NamedTuple):
    """Stretch of constant grade."""

    length: float
    grade: float


def room(x: Array, least: float = LEAST_SLOPE) -> float:
    """Length of a tile between approach and run-out, m.

    Args:
        x: Places along the tile, from 0 to its length, m.
        least: Length that is needed, m.

    Raises:
        UserError: If there is less.
    """
    length = float(x.max())
    between = length - APPROACH - RUN_OUT
    if between < least - 1e-9:
        raise UserError(
            f"a tile of {length:g} m has no room for a slope of {least:g} m between {APPROACH:g} m of approach and "
            f"{RUN_OUT:g} m of run-out; tile_length must be at least {APPROACH + least + RUN_OUT:g} m."
        )
    return between


def flat(x: Array) -> Array:
    """Level ground."""
    return np.zeros_like(x)


def ramp(x: Array, grade: float) -> Array:
    """Plane of constant grade between approach and run-out.

    Args:
        x: Places along the tile, from 0 to its length, m.
        grade: Degrees; negative goes down.

    Raises:
        UserError: If the tile is too short for a ramp of `LEAST_SLOPE`.
    """
    return np.tan(np.radians(grade)) * np.clip(x - APPROACH, 0.0, room(x))


def ramp_down(x: Array, grade: float) -> Array:
    """As `ramp`, with positive grades going down."""
    return ramp(x, -grade)


def plane(x: Array, y: Array, grade: float, uphill: float) -> Array:
    """Plane through height 0 in the middle of the tile, without approach or run-out.

    Args:
        x, y: Places on the tile, m.
        grade: Degrees.
        uphill: Direction in which it rises, degrees from +x towards +y.
    """
    towards = np.radians(uphill)
    along = (x - x.mean()) * np.cos(towards) + (y - y.mean()) * np.sin(towards)
    return np.tan(np.radians(grade)) * along


def track(x: Array, segments: Sequence[Segment]) -> Array:
    """Segments of constant grade one after the other from x = 0, and level ground after the last one."""
    lengths = np.array([segment.length for segment in segments])
    rises = lengths * np.tan(np.radians([segment.grade for segment in segments]))
    knots = np.concatenate(([0.0], np.cumsum(lengths)))
    return np.interp(x, knots, np.concatenate(([0.0], np.cumsum(rises))))
