"""Proportions and means of independent trials, with confidence intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit  # scipy.stats takes as long to import as all that `play` needs

from humoslope.errors import UserError

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Proportion:
    """Number of independent trials in which an event happened.

    Attributes:
        count: Trials in which it happened.
        total: All trials.
        low, high: Wilson's score interval for the true share.
    """

    count: int
    total: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """Observed share, in [0, 1]."""
        return self.count / self.total


def proportion(count: int, total: int, confidence: float = 0.95) -> Proportion:
    """Share of `count` in `total` trials with Wilson's score interval (Wilson 1927).

    Unlike the interval of the normal approximation it keeps a width when the count is 0 or all.

    Args:
        confidence: Share of such intervals that contain the true share.

    Raises:
        UserError: If there were no trials, or fewer than `count`.
    """
    if not 0 <= count <= total or total < 1:
        raise UserError(f"proportion: {count} of {total} trials; there must be at least one, and no more than all.")
    z = float(ndtri(0.5 + 0.5 * confidence))
    share, weight = count / total, 1.0 + z**2 / total
    middle = (share + 0.5 * z**2 / total) / weight
    half = z * math.sqrt(share * (1.0 - share) / total + 0.25 * (z / total) ** 2) / weight
    # The ends are known exactly; rounding would miss them by a little.
    return Proportion(count, total, middle - half if count else 0.0, middle + half if count < total else 1.0)


@dataclass(frozen=True)
class Average:
    """Mean of a quantity over independent trials.

    Attributes:
        mean: Mean over the trials.
        trials: Number of trials in which it was measured.
        std: Standard deviation between trials, with n - 1; None for a single trial.
        low, high: Student's t interval for the true mean; None for a single trial.
    """

    mean: float
    trials: int
    std: float | None
    low: float | None
    high: float | None


def average(values: Array, confidence: float = 0.95) -> Average | None:
    """Mean of the values that are not NaN, with Student's interval; None if all are NaN ("nothing was measured").

    Args:
        values: One value for each trial.
        confidence: Share of such intervals that contain the true mean, if trials are normally distributed or many.
    """
    measured = values[~np.isnan(values)]
    if measured.size == 0:
        return None
    middle = float(measured.mean())
    if measured.size == 1:
        return Average(middle, 1, None, None, None)
    std = float(measured.std(ddof=1))
    half = float(stdtrit(measured.size - 1, 0.5 + 0.5 * confidence)) * std / math.sqrt(measured.size)
    return Average(middle, measured.size, std, middle - half, middle + half)


def mean(values: Array) -> float | None:
    """Mean of the values that are not NaN; None if all are NaN ("nothing was measured")."""
    measured = values[~np.isnan(values)]
    return float(measured.mean()) if measured.size else None


def largest(values: Array) -> float | None:
    """Largest of the values that are not NaN; None if all are NaN ("nothing was measured")."""
    measured = values[~np.isnan(values)]
    return float(measured.max()) if measured.size else None
