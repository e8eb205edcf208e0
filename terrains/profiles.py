"""The course of the ground along the direction of travel, from height 0; lengths in metres, grades in degrees."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from humoslope.terrain.registry import Array

APPROACH = 1.5
"""Flat ground before a ramp, where robots start, m."""
RUN_OUT = 1.5
"""Flat ground after a ramp, m."""


class Segment(NamedTuple):
    """A stretch of constant grade."""

    length: float
    grade: float


def flat(x: Array) -> Array:
    """Level ground."""
    return np.zeros_like(x)


def ramp(x: Array, grade: float, start: float = APPROACH, length: float | None = None) -> Array:
    """A plane of constant grade between two flats.

    Args:
        x: Along the direction of travel, m.
        grade: Degrees; negative goes down.
        start: Where the ramp begins.
        length: Its extent in x; by default it ends `RUN_OUT` before the last x.
    """
    if length is None:
        length = float(x.max()) - RUN_OUT - start
    return np.tan(np.radians(grade)) * np.clip(x - start, 0.0, max(length, 0.0))


def ramp_down(x: Array, grade: float, start: float = APPROACH, length: float | None = None) -> Array:
    """As `ramp`, with positive grades going down."""
    return ramp(x, -grade, start, length)


def track(x: Array, segments: Sequence[Segment]) -> Array:
    """Segments of constant grade one after the other from x = 0; level after the last."""
    lengths = np.array([segment.length for segment in segments])
    rises = lengths * np.tan(np.radians([segment.grade for segment in segments]))
    knots = np.concatenate(([0.0], np.cumsum(lengths)))
    return np.interp(x, knots, np.concatenate(([0.0], np.cumsum(rises))))
