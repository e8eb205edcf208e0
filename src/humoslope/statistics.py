"""Numbers that say how sure a measurement is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, t

from humoslope.errors import UserError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Proportion:
    """How often something happened in independent trials.

    Attributes:
        count: Trials in which it happened.
        total: Trials there were.
        low, high: Interval for the true share, by Wilson's score.
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
    """The share of `count` in `total` trials with Wilson's score interval (Wilson 1927).

    Unlike the interval of the normal approximation it keeps a width when nothing or everything happened.

    Args:
        confidence: Share of such intervals that hold the true share.

    Raises:
        UserError: If there were no trials, or fewer than `count`.
    """
    if not 0 <= count <= total or total < 1:
        raise UserError(f"proportion: {count} of {total} trials; there must be at least one, and no more than all.")
    interval = binomtest(count, total).proportion_ci(confidence_level=confidence, method="wilson")
    return Proportion(count, total, float(interval.low), float(interval.high))


@dataclass(frozen=True)
class Average:
    """The mean of something measured in independent trials.

    Attributes:
        mean: Over the trials.
        trials: In which it was measured.
        std: Standard deviation between trials, by n - 1; None of a single trial.
        low, high: Interval for the true mean, by Student's t; None of a single trial.
    """

    mean: float
    trials: int
    std: float | None
    low: float | None
    high: float | None


def average(values: Array, confidence: float = 0.95) -> Average | None:
    """The mean of the values that are there, with Student's interval; None if all are NaN ("nothing was measured").

    Args:
        values: One for each trial.
        confidence: Share of such intervals that hold the true mean, if trials scatter normally or are many.
    """
    there = values[~np.isnan(values)]
    if there.size == 0:
        return None
    middle = float(there.mean())
    if there.size == 1:
        return Average(middle, 1, None, None, None)
    std = float(there.std(ddof=1))
    half = float(t.ppf(0.5 + 0.5 * confidence, there.size - 1)) * std / math.sqrt(there.size)
    return Average(middle, there.size, std, middle - half, middle + half)


def mean(values: Array) -> float | None:
    """The mean of the values that are there; None if all are NaN, which stands for "nothing was measured"."""
    there = values[~np.isnan(values)]
    return float(there.mean()) if there.size else None
