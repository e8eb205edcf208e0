"""Search for the limit of a quantity over a grid from "surely fine" to "surely not"."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

from humoslope.errors import UserError
from humoslope.ranges import Checked, Count, Range
from humoslope.statistics import proportion

GUARDS = 2
"""Values just within the limit that are tested, so that one lucky outcome far beyond the true limit is found out."""
FIRST_LOOK = 16
"""Trials before a value is judged for the first time; their number doubles until the outcome is clear."""


@dataclass(frozen=True)
class Rule(Checked):
    """Rule by which a value is judged.

    Attributes:
        trials: Most trials of one value. Fewer are run where the outcome is clear sooner.
        share: Share of trials that must succeed.
        confidence: One-sided confidence of Wilson's bound on the share; 0.5 takes the observed share itself.
    """

    VERB: ClassVar[str] = "margins"

    trials: Count = 256
    share: Annotated[float, Range(0.0, 1.0, open_low=True, open_high=True)] = 0.95
    confidence: Annotated[float, Range(0.5, 1.0, open_high=True)] = 0.95

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.judge(self.trials, self.trials) is not True:
            enough = next(n for n in range(1, 1_000_000) if self.lower(n, n) >= self.share)
            raise UserError(
                f"margins: {self.trials} trials cannot show {100 * self.share:g} % with a confidence of "
                f"{self.confidence:g}, even if all succeed; at least {enough} are needed."
            )

    @property
    def looks(self) -> tuple[int, ...]:
        """Numbers of trials after which a value is judged."""
        doublings = range(max(0, math.ceil(math.log2(self.trials / FIRST_LOOK))))
        return *(FIRST_LOOK * 2**k for k in doublings), self.trials

    def lower(self, successes: int, trials: int) -> float:
        """Wilson's lower bound on the share of successes."""
        return proportion(successes, trials, 2.0 * self.confidence - 1.0).low

    def judge(self, successes: int, trials: int) -> bool | None:
        """Returns whether the share is reached; None if that is not clear and more trials may tell.

        A value that is still unclear after the most trials is not shown to hold, so it does not.
        """
        if self.lower(successes, trials) >= self.share:
            return True
        upper = proportion(successes, trials, 2.0 * self.confidence - 1.0).high
        return False if upper < self.share or trials >= self.trials else None


@dataclass
class Search:
    """Bisection over the indices 0 to `size` - 1 of a grid. The first one is tested before all others.

    The limit is a value that holds, as do all tested values before it and `GUARDS` neighbours just before it; the next
    value of the grid fails, or does not exist. There is none if the first value fails. If a guard fails, a lucky outcome has misled the bisection, which starts
    over below the guard. The value after the first failing one is tested too: if it holds, the outcomes are not
    monotone, which is reported, and the limit stays where it is, on the safe side.

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
