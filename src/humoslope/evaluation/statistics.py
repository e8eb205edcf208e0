"""Numbers that say how sure a measurement is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

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


def mean(values: Array) -> float | None:
    """The mean of the values that are there; None if all are NaN, which stands for "nothing was measured"."""
    there = values[~np.isnan(values)]
    return float(there.mean()) if there.size else None
