"""Surfaces on top of a profile; heights in metres, to be added to it.

Every surface fades in from `start` on, and out before `end`. The default start keeps the profile unchanged where robots
start.
"""

from __future__ import annotations

import numpy as np

from humoslope.terrain.registry import Array

SPAWN = 1.2
"""Length of the ground where robots start, m."""
BLEND = 0.3
"""Length over which a surface fades, m."""
BANK_BLEND = 0.8
"""Length over which banked ground fades, m; longer, as twisted ground is steep off its centre line."""


def fade(x: Array, start: float = SPAWN, end: float = np.inf, blend: float = BLEND) -> Array:
    """Weight of a surface: 0 outside [start, end], 1 well inside, and linear over `blend` metres between."""
    return np.clip(np.minimum(x - start, end - x) / blend, 0.0, 1.0)


def smooth(x: Array) -> Array:
    """No change to the profile."""
    return np.zeros_like(x)


def wavy(
    x: Array,
    amplitude: float = 0.04,
    wavelength: float = 1.25,
    phase: float = 0.0,
    *,
    start: float = SPAWN,
    end: float = np.inf,
) -> Array:
    """Sine waves along the direction of travel; amplitude from the mean, wavelength in metres, phase in rad."""
    return amplitude * np.sin(2.0 * np.pi * x / wavelength + phase) * fade(x, start, end)


def banked(x: Array, y: Array, angle: float, *, start: float = SPAWN, end: float = np.inf) -> Array:
    """Ground tilted sideways by an angle in degrees; positive lifts the left."""
    return np.tan(np.radians(angle)) * y * fade(x, start, end, BANK_BLEND)


def rough(
    x: Array,
    y: Array,
    rng: np.random.Generator,
    amplitude: float = 0.03,
    spacing: float = 0.2,
    *,
    start: float = SPAWN,
    end: float = np.inf,
) -> Array:
    """Random bumps within +-amplitude, uniform on a lattice of `spacing` metres and bilinear between its points."""
    u, v = (x - x.min()) / spacing, (y - y.min()) / spacing
    i, j = u.astype(int), v.astype(int)
    lattice = rng.uniform(-amplitude, amplitude, (int(i.max()) + 2, int(j.max()) + 2))
    fu, fv = u - i, v - j
    near = lattice[i, j] * (1.0 - fv) + lattice[i, j + 1] * fv
    far = lattice[i + 1, j] * (1.0 - fv) + lattice[i + 1, j + 1] * fv
    return (near * (1.0 - fu) + far * fu) * fade(x, start, end)


def striped(
    x: Array,
    height: float = 0.025,
    period: float = 0.5,
    width: float = 0.1,
    edge: float = 0.05,
    *,
    start: float = SPAWN,
    end: float = np.inf,
) -> Array:
    """Ribs across the direction of travel, `width` metres wide on top with sides that fall over `edge` metres."""
    distance = np.abs(x - period * np.round(x / period))  # from the middle of the nearest rib
    return height * np.clip(1.0 - (distance - 0.5 * width) / edge, 0.0, 1.0) * fade(x, start, end)
