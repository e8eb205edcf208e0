"""Search for the limit of a quantity over a grid from "surely fine" to "surely not"."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, ClassVar

from scipy.special import betaincinv

from humoslope.errors import UserError
from humoslope.ranges import Checked, Count, Range

GUARDS = 2
"""Values just within the limit that are tested, so that one lucky outcome far beyond the true limit is found out."""
FIRST_LOOK = 16
"""Trials before a value is judged for the first time; their number doubles until the outcome is clear."""


@dataclass(frozen=True)
class Rule(Checked):
    """Rule by which a value is judged.

    A value that is not better than `share` is shown to hold with a probability of 1 - `confidence` at most, however
    often it was looked at. That error is spent in equal parts on the looks that may show it, each by the exact binomial
    bound (Clopper & Pearson 1934; the parts by Bonferroni). The confidence is that of one value, not of all together.

    Attributes:
        trials: Most trials of one value. Fewer are run where the outcome is clear sooner.
        share: Share of trials that must succeed.
        confidence: One-sided confidence that a value which was shown to hold reaches the share, over all looks at it.
    """

    VERB: ClassVar[str] = "margins"

    trials: Count = 256
    share: Annotated[float, Range(0.0, 1.0, open_low=True, open_high=True)] = 0.95
    confidence: Annotated[float, Range(0.5, 1.0, open_high=True)] = 0.95

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.judge(self.trials, self.trials) is not True:
            enough = math.ceil(math.log(1.0 - self.confidence) / math.log(self.share))  # share ** n is the error then
            raise UserError(
                f"margins: {self.trials} trials cannot show a share of {self.share:.10g} with a confidence of "
                f"{self.confidence:.10g}, even if all succeed; at least {enough} are needed."
            )

    @property
    def looks(self) -> tuple[int, ...]:
        """Numbers of trials after which a value is judged."""
        doublings = range(max(0, math.ceil(math.log2(self.trials / FIRST_LOOK))))
        return *(FIRST_LOOK * 2**k for k in doublings), self.trials

    @cached_property
    def decisive(self) -> tuple[int, ...]:
        """Looks that may show a value to hold: as many of the last ones as can, each with its part of the error."""
        error, looks = 1.0 - self.confidence, self.looks
        able = (looks[-k:] for k in range(len(looks), 1, -1) if self.share ** looks[-k] <= error / k)
        return next(able, looks[-1:])

    @property
    def error(self) -> float:
        """Probability that one of the decisive looks errs, at most."""
        return (1.0 - self.confidence) / len(self.decisive)

    def lower(self, successes: int, trials: int) -> float:
        """Lower bound on the share of successes, wrong with a probability of `error` at most."""
        return float(betaincinv(successes, trials - successes + 1, self.error)) if successes else 0.0

    def upper(self, successes: int, trials: int) -> float:
        """Upper bound on the share of successes, wrong with a probability of `error` at most."""
        return float(betaincinv(successes + 1, trials - successes, 1.0 - self.error)) if successes < trials else 1.0

    def judge(self, successes: int, trials: int) -> bool | None:
        """Returns whether the share is reached, at a look; None if that is not clear and more trials may tell.

        A value that is still unclear after the most trials is not shown to hold, so it does not.
        """
        if trials in self.decisive and self.lower(successes, trials) >= self.share:
            return True
        return False if trials >= self.trials or self.upper(successes, trials) < self.share else None


@dataclass
class Search:
    """Bisection over the indices 0 to `size` - 1 of a grid. The first one is tested before all others.

    The limit is a value that holds, as do all tested values before it and `GUARDS` neighbours just before it; the next
    value of the grid fails, or does not exist. There is none if the first value fails. If a guard fails, a lucky
    outcome has misled the bisection, which starts over below the guard. The value after the first failing one is tested
    too: if it holds, the outcomes are not monotone, which is reported, and the limit stays where it is, on the safe
    side.

    Attributes:
        size: Number of values.
        outcomes: Outcomes so far by index, such as {0: True} where the first value is known to hold.
    """

    size: int
    outcomes: dict[int, bool] = field(default_factory=dict)

    @property
    def failing(self) -> int:
        """Lowest index known to fail; `size` if there is none."""
        return min((i for i, holds in self.outcomes.items() if not holds), default=self.size)

    @property
    def limit(self) -> int:
        """Highest index known to hold below all that fail; -1 if there is none."""
        return max((i for i, holds in self.outcomes.items() if holds and i < self.failing), default=-1)

    @property
    def monotone(self) -> bool:
        """True if no tested value holds beyond one that fails."""
        return not any(holds for i, holds in self.outcomes.items() if i > self.failing)

    @property
    def tests_left(self) -> int:
        """Estimate of the number of values still to be tested."""
        gap = self.failing - self.limit - 1
        guards = sum(i not in self.outcomes for i in range(max(1, self.limit - GUARDS), self.limit))
        return gap.bit_length() + guards + (self.failing + 1 < self.size and self.failing + 1 not in self.outcomes)

    def run(self) -> Generator[int, bool, None]:
        """Yields the index to test next and takes its outcome."""
        while (index := self._next()) is not None:
            self.outcomes[index] = yield index

    def _next(self) -> int | None:
        if 0 not in self.outcomes:
            return 0
        low, high = self.limit, self.failing
        if high - low > 1:
            return (low + high) // 2
        wanted = (*range(low - 1, max(0, low - 1 - GUARDS), -1), *range(high + 1, min(high + 2, self.size)))
        return next((i for i in wanted if i not in self.outcomes), None)
