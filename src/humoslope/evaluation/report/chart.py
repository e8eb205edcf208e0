"""Curves in characters, for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from humoslope.statistics import Array

EIGHTHS = " ▁▂▃▄▅▆▇█"


def chart(
    values: Sequence[float], width: int, height: int, low: float | None = None, high: float | None = None
) -> list[str]:
    """Lines of text, the highest first, with a bar for each of `width` equal parts of the values.

    Args:
        values: The curve; what is not finite is left out.
        low, high: Ends of the axis; by default those of the values.

    Returns:
        `height` lines of at most `width` characters; empty ones if there are no values.
    """
    there = np.array([value for value in values if np.isfinite(value)], dtype=np.float64)
    if not len(there):
        return [""] * height
    means = thinned(there, width)
    bottom = float(means.min()) if low is None else low
    top = float(means.max()) if high is None else high
    span = top - bottom if top > bottom else 1.0
    # The lowest value has a bar of an eighth, so that it is there at all.
    eighths = 1 + np.rint((8 * height - 1) * np.clip((means - bottom) / span, 0.0, 1.0)).astype(int)
    rows = [np.clip(eighths - 8 * row, 0, 8) for row in reversed(range(height))]
    return ["".join(EIGHTHS[n] for n in row) for row in rows]


def thinned(values: Array, width: int) -> Array:
    """Means of `width` parts of equal length; the values themselves if they are fewer."""
    if len(values) <= width:
        return values
    return np.array([part.mean() for part in np.array_split(values, width)])
