"""Terrains for training."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from humoslope.terrain import terrain
from humoslope.terrain.registry import Array
from terrains.profiles import APPROACH, Segment, flat, plane, ramp, ramp_down, room, track
from terrains.surfaces import banked, rough, smooth, striped, wavy

STEEPEST = 32.0
"""Steepest ramp, degrees; a little beyond the 30 degrees of the evaluation."""
STEEPEST_TRACK = 35.0
"""Steepest slope of the tracks of Stage II, degrees."""
MAX_BANK = 8.0
"""Largest sideways tilt, degrees."""
BUMP = 0.03
"""Largest height of bumps above and below the profile, m."""
RIB = 0.03
"""Largest height of ribs, m."""
LEAST_TRACK = 3.5
"""Length of two slopes and the flat between them, m: the shorter slope has at least 30 % of it, see `compound`."""
BUMP_SPACING = 0.2
"""Distance between bumps, m."""


@terrain("flat", grade=(0.0, 0.0))
def flat_ground(x: Array, y: Array, grade: float, rng: np.random.Generator) -> Array:
    """Level ground at every difficulty."""
    return flat(x)


@terrain("ramp-up", grade=(0.0, STEEPEST))
def ramp_up(x: Array, y: Array, grade: float, rng: np.random.Generator) -> Array:
    """Planar ramp up."""
    return ramp(x, grade)


@terrain("ramp-down", grade=(0.0, STEEPEST))
def ramp_downwards(x: Array, y: Array, grade: float, rng: np.random.Generator) -> Array:
    """Planar ramp down."""
    return ramp_down(x, grade)


@terrain("rough-ramp-up", grade=(0.0, STEEPEST))
def rough_ramp_up(x: Array, y: Array, grade: float, rng: np.random.Generator) -> Array:
    """Ramp up with bumps that grow with its grade."""
    return ramp(x, grade) + rough(x, y, rng, BUMP * grade / STEEPEST, BUMP_SPACING)


@terrain("rough-ramp-down", grade=(0.0, STEEPEST))
def rough_ramp_down(x: Array, y: Array, grade: float, rng: np.random.Generator) -> Array:
    """Ramp down with bumps that grow with its grade."""
    return ramp_down(x, grade) + rough(x, y, rng, BUMP * grade / STEEPEST, BUMP_SPACING)


@terrain("striped-ramp-up", grade=(0.0, STEEPEST))
def striped_ramp_up(x: Array, y: Array, grade: float, rng: np.random.Generator) -> Array:
    """Ramp up with ribs across."""
    return ramp(x, grade) + striped(x, RIB * grade / STEEPEST, rng.choice((0.4, 0.5)))


@terrain("striped-ramp-down", grade=(0.0, STEEPEST))
def striped_ramp_down(x: Array, y: Array, grade: float, rng: np.random.Generator) -> Array:
    """Ramp down with ribs across."""
    return ramp_down(x, grade) + striped(x, RIB * grade / STEEPEST, rng.choice((0.4, 0.5)))


@terrain("wave", grade=(0.0, 12.0))
def wave(x: Array, y: Array, grade: float, rng: np.random.Generator) -> Array:
    """Waves of 1 to 1.5 m whose steepest place has the grade; at 12 degrees their amplitude is 3.4 to 5.1 cm."""
    wavelength = rng.uniform(1.0, 1.5)
    amplitude = np.tan(np.radians(grade)) * wavelength / (2.0 * np.pi)
    return flat(x) + wavy(x, amplitude, wavelength, rng.uniform(0.0, 2.0 * np.pi))


@terrain("rough", grade=(0.0, 8.5))
def rough_ground(x: Array, y: Array, grade: float, rng: np.random.Generator) -> Array:
    """Bumps whose height over their spacing is the grade; at 8.5 degrees they are 3 cm high."""
    return flat(x) + rough(x, y, rng, np.tan(np.radians(grade)) * BUMP_SPACING, BUMP_SPACING)


@terrain("banked", grade=(0.0, MAX_BANK))
def banked_ground(x: Array, y: Array, grade: float, rng: np.random.Generator) -> Array:
    """Ground tilted to the left or to the right by the grade."""
    return flat(x) + banked(x, y, grade * rng.choice((-1.0, 1.0)))


@terrain("compound", grade=(0.0, STEEPEST_TRACK))
def compound(x: Array, y: Array, grade: float, rng: np.random.Generator) -> Array:
    """Two ramps, up and down in random order, with a flat between; lengths and the surface of each are random too.

    The surfaces do not depend on the grade.
    """
    length = room(x, LEAST_TRACK)
    plateau = round(length * rng.uniform(0.15, 0.25), 1)
    first = round((length - plateau) * rng.uniform(0.4, 0.6), 1)
    second = length - plateau - first
    sign = rng.choice((-1.0, 1.0))
    segments = [
        Segment(APPROACH, 0.0),
        Segment(first, sign * grade),
        Segment(plateau, 0.0),
        Segment(second, -sign * grade),
    ]
    beyond = APPROACH + first + plateau
    return (
        track(x, segments)
        + _any_surface(x, y, rng, APPROACH, APPROACH + first)
        + _any_surface(x, y, rng, beyond, beyond + second)
    )


@terrain("hillside", grade=(0.0, STEEPEST), omnidirectional=True)
def hillside(x: Array, y: Array, grade: float, rng: np.random.Generator) -> Array:
    """Plane over the whole tile that rises in a random direction; walked in any direction from any place."""
    return plane(x, y, grade, rng.uniform(-180.0, 180.0))


@terrain("rough-hillside", grade=(0.0, STEEPEST), omnidirectional=True)
def rough_hillside(x: Array, y: Array, grade: float, rng: np.random.Generator) -> Array:
    """Hillside with bumps all over that grow with its grade."""
    bumps = rough(x, y, rng, BUMP * grade / STEEPEST, BUMP_SPACING, start=-np.inf)
    return plane(x, y, grade, rng.uniform(-180.0, 180.0)) + bumps


def _any_surface(x: Array, y: Array, rng: np.random.Generator, start: float, end: float) -> Array:
    """Random surface of the five, between two places along the tile."""
    choices: tuple[Callable[[], Array], ...] = (
        lambda: smooth(x),
        lambda: wavy(
            x, rng.uniform(0.03, 0.05), rng.uniform(1.0, 1.5), rng.uniform(0.0, 2.0 * np.pi), start=start, end=end
        ),
        lambda: banked(x, y, rng.uniform(-MAX_BANK, MAX_BANK), start=start, end=end),
        lambda: rough(x, y, rng, BUMP, BUMP_SPACING, start=start, end=end),
        lambda: striped(x, rng.uniform(0.02, RIB), rng.choice((0.4, 0.5)), start=start, end=end),
    )
    return choices[rng.integers(len(choices))]()
