"""The held-out track for the evaluation of policies; none is trained on it (paper, section 4).

The paper gives its length, the kinds of segments and the five surfaces. Their order, lengths and sizes are ours: 22 m
of the track are slopes, each followed by level ground, and no surface but the smooth one occurs twice on them.
"""

from __future__ import annotations

import numpy as np

from humoslope.terrain.course import Segment, course
from humoslope.terrain.registry import Array
from terrains import profiles
from terrains.surfaces import fade, rough, striped, wavy

SEGMENTS = (
    Segment("start", 2.0, 0, "smooth"),
    Segment("up smooth", 4.0, +1, "smooth"),
    Segment("plateau 1", 2.0, 0, "smooth"),
    Segment("down wavy", 4.0, -1, "wavy"),
    Segment("flat 1", 2.0, 0, "smooth"),
    Segment("up banked", 3.0, +1, "banked"),
    Segment("plateau 2", 1.5, 0, "smooth"),
    Segment("down rough", 3.0, -1, "rough"),
    Segment("flat 2", 1.5, 0, "smooth"),
    Segment("up striped", 4.0, +1, "striped"),
    Segment("plateau 3", 1.5, 0, "smooth"),
    Segment("down smooth", 4.0, -1, "smooth"),
    Segment("end", 2.5, 0, "smooth"),
)
WIDTH = 6.0
"""Extent across, m; a blind robot drifts, and its command steers back only gently."""
CELL = 0.05
"""Distance between neighbouring heights, m; the edge of a rib is one cell."""
BLEND = 0.2
"""Length over which a surface fades at the ends of its segment, m."""
SEED = 20_260_917
"""Seed of the bumps. Training seeds are small numbers combined with a column and a level."""

WAVE_AMPLITUDE, WAVELENGTH = 0.04, 1.2  # m; training draws wavelengths and phases at random
BUMP, BUMP_SPACING = 0.03, 0.15  # m; training spaces them by 0.2
RIB, RIB_PERIOD = 0.025, 0.45  # m; training has 0.4 and 0.5
BANK = 8.0
"""Sideways tilt, degrees; beyond about 12 no foot of the G1 lies flat. The left is higher first, then the right."""
BANK_AT = (0.0, 0.5, 1.1, 1.9, 2.5, 3.0)
BANK_SHARE = (0.0, 1.0, 1.0, -1.0, -1.0, 0.0)
"""Places in the banked segment, m, and shares of the tilt there; ground that twists faster is steep off its middle."""


@course("held-out-track", SEGMENTS, grade=(0.0, 40.0), width=WIDTH, cell=CELL)
def held_out_track(x: Array, y: Array, grade: float, rng: np.random.Generator) -> Array:
    """Track of 35 m for evaluations: slopes up and down with five surfaces.

    The surfaces do not depend on the grade, and the track has its own seed, so that the bumps are always the same.
    """
    own = np.random.default_rng(SEED)
    slopes = profiles.track(x, [profiles.Segment(s.length, s.direction * grade) for s in SEGMENTS])
    on = {surface: _weight(x, surface) for surface in ("wavy", "rough", "striped")}
    return (
        slopes
        + on["wavy"] * wavy(x - _start("wavy"), WAVE_AMPLITUDE, WAVELENGTH, start=-np.inf)
        + on["rough"] * rough(x, y, own, BUMP, BUMP_SPACING, start=-np.inf)
        + on["striped"] * striped(x - _start("striped"), RIB, RIB_PERIOD, start=-np.inf)
        + np.tan(np.radians(BANK)) * y * np.interp(x - _start("banked"), BANK_AT, BANK_SHARE)
    )


def _start(surface: str) -> float:
    """Start of the only segment with that surface, m."""
    index = [segment.surface for segment in SEGMENTS].index(surface)
    return sum(segment.length for segment in SEGMENTS[:index])


def _weight(x: Array, surface: str) -> Array:
    start = _start(surface)
    length = next(segment.length for segment in SEGMENTS if segment.surface == surface)
    return fade(x, start, start + length, BLEND)
