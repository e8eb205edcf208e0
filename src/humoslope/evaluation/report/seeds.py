"""Figures of a method over several trainings: an interval that holds for seeds and for trials.

The method is the hierarchical bootstrap (Davison & Hinkley 1997, section 3.8): seeds are drawn with replacement, and in
each of them trials. Two things are added for few seeds. Deviations of the seeds are scaled by sqrt(n / (n - 1)), and
the interval by Student's quantile over the normal one, as Hesterberg (2015) advises against the
narrowness of bootstraps of few. And of shares, such as of successes, a trial is drawn from Jeffreys' posterior, so
that 96 of 96 is not taken for certainty. All draws are seeded.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from humoslope.statistics import Array

DRAWS = 4000
"""Draws of a bootstrap."""
CONFIDENCE = 0.95
TRIM = 0.25
"""Share that the interquartile mean leaves out at either end."""
ENOUGH_FOR_IQM = 4
"""Seeds from which on the interquartile mean leaves any out; with fewer it is the mean."""


@dataclass(frozen=True)
class Estimate:
    """A figure over seeds, or a difference of two.

    Attributes:
        value: The figure.
        low, high: Interval for the true one; over trials alone if there is one seed, None if nothing varies that could
            be drawn from.
        seeds: Number of seeds; of a difference, that of the method with fewer.
    """

    value: float
    low: float | None
    high: float | None
    seeds: int

    @property
    def separate(self) -> bool:
        """True if it is a difference over several seeds whose interval is on one side of zero."""
        return self.seeds > 1 and self.low is not None and self.high is not None and (self.low > 0.0 or self.high < 0.0)


@dataclass(frozen=True)
class Trials:
    """Trials of one seed. Its score is the sum of `values` over the sum of `weights`, by default their mean.

    Attributes:
        values: Values [M] without NaN.
        weights: Weights [M] without NaN.
        shares: True if values are 0 or 1.
    """

    values: Array
    weights: Array
    shares: bool = False

    @classmethod
    def of(cls, values: Array, weights: Array | None = None, shares: bool = False) -> Trials | None:
        """Trials whose values and weights are not NaN; None if there are none."""
        weights = np.ones_like(values) if weights is None else weights
        there = ~(np.isnan(values) | np.isnan(weights))
        return cls(values[there], weights[there], shares) if weights[there].sum() > 0.0 else None

    @property
    def score(self) -> float:
        """Score of the seed."""
        return float(self.values.sum() / self.weights.sum())

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Scores [count] of as many trials, drawn with replacement."""
        size = len(self.values)
        if self.shares:
            successes = self.values.sum()
            return rng.beta(successes + 0.5, size - successes + 0.5, count)
        if size == 1:
            return np.full(count, self.score)
        chosen = rng.integers(size, size=(count, size))
        return self.values[chosen].sum(axis=1) / self.weights[chosen].sum(axis=1)


class Scores:
    """Trials of a method over its seeds.

    Args:
        trials: Trials of each seed.
        name: Decides the random numbers: two figures with different names are drawn independently.
    """

    def __init__(self, trials: Sequence[Trials], name: str = "") -> None:
        self.trials, self._name = tuple(trials), name

    @cached_property
    def scores(self) -> Array:
        """Score [n] of each seed."""
        return np.array([trials.score for trials in self.trials])

    @cached_property
    def drawn(self) -> Array:
        """Scores [DRAWS, n] of seeds, and of trials in them, drawn with replacement."""
        rng, n = np.random.default_rng(zlib.crc32(self._name.encode())), len(self.trials)
        chosen = rng.integers(n, size=(DRAWS, n))
        drawn = np.empty((DRAWS, n))
        for seed, trials in enumerate(self.trials):
            here = chosen == seed
            drawn[here] = trials.draw(rng, int(here.sum()))
        return drawn

    @property
    def varies(self) -> bool:
        """True if there is anything to draw from: several seeds, or several trials."""
        return len(self.trials) > 1 or len(self.trials[0].values) > 1

    def estimate(self, low: float = -math.inf, high: float = math.inf) -> Estimate:
        """Mean over the seeds, each with the same weight.

        Args:
            low, high: Bounds of the quantity.
        """
        n = len(self.trials)
        return self._estimate(lambda scores: scores.mean(axis=-1), n - 1, low, high)

    def interquartile_mean(self, low: float = -math.inf, high: float = math.inf) -> Estimate:
        """Mean of the middle half of the seeds (Agarwal et al. 2021, "rliable"), as `scipy.stats.trim_mean` has it.

        The degrees of freedom are those of the seeds that are left (Tukey & McLaughlin 1963).
        """
        from scipy.stats import trim_mean  # takes long to import

        n = len(self.trials)
        left = n - 2 * int(TRIM * n)
        return self._estimate(lambda scores: trim_mean(scores, TRIM, axis=-1), left - 1, low, high)

    def _estimate(self, reduce: Callable[[Array], Array], freedom: int, low: float, high: float) -> Estimate:
        value = float(reduce(self.scores))
        if not self.varies:
            return Estimate(value, None, None, len(self.trials))
        drawn = value + _narrowness(len(self.trials)) * (reduce(self.drawn) - value)
        found = _interval(value, drawn, freedom)
        return Estimate(value, max(low, found[0]), min(high, found[1]), len(self.trials))

    def minus(self, other: Scores) -> Estimate:
        """Difference of the means of two methods whose seeds are independent of each other."""
        value = float(self.scores.mean() - other.scores.mean())
        seeds = min(len(self.trials), len(other.trials))
        if not (self.varies and other.varies):
            return Estimate(value, None, None, seeds)
        parts = [
            _narrowness(len(side.trials)) * (side.drawn.mean(axis=1) - side.scores.mean()) for side in (self, other)
        ]
        low, high = _interval(value, value + parts[0] - parts[1], _welch(self.scores, other.scores))
        return Estimate(value, low, high, seeds)


def _interval(value: float, drawn: Array, freedom: float) -> tuple[float, float]:
    """Percentiles of draws, further from the figure by Student's quantile over the normal one; 0: as they are."""
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.quantile(drawn, (tail, 1.0 - tail))
    wider = float(stdtrit(freedom, 1.0 - tail) / ndtri(1.0 - tail)) if freedom > 0.0 else 1.0
    # The draws of a share are centred a little nearer to a half than the share itself.
    return value + wider * min(0.0, float(low) - value), value + wider * max(0.0, float(high) - value)


def _narrowness(n: int) -> float:
    """Factor by which the mean of n drawn seeds deviates too little."""
    return math.sqrt(n / (n - 1)) if n > 1 else 1.0


def _welch(first: Array, second: Array) -> float:
    """Degrees of freedom of a difference of means (Welch 1947); a single seed has none, and lends none."""
    sides: list[NDArray[np.float64]] = [side for side in (first, second) if len(side) > 1]
    parts = [(side.var(ddof=1) / len(side), len(side) - 1) for side in sides]
    below = sum(part**2 / freedom for part, freedom in parts)
    total = sum(part for part, _ in parts)
    return float(total**2 / below) if below > 0.0 else float(sum(freedom for _, freedom in parts))
