"""The slope limit: how steep a course a policy still masters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

ENOUGH = 0.5
"""Share of successes that a mastered grade has; ours, the paper does not say."""


@dataclass(frozen=True)
class SlopeLimit:
    """What a sweep found. Grades in degrees; None: not even the lowest that was swept.

    Attributes:
        grade: The steepest grade that is mastered, all lower ones of the sweep being mastered too.
        any_success: The steepest grade with at least one success, whatever lies below.
        beyond: Whether the steepest grade of the sweep is mastered, so that the limit lies there or higher.
    """

    grade: float | None
    any_success: float | None
    beyond: bool


def slope_limit(grades: Sequence[float], successes: Sequence[int], trials: Sequence[int]) -> SlopeLimit:
    """The limit from the outcomes at each grade. The climb stops at the first grade that is not mastered: a steeper one
    that happens to be does not count."""
    rising = sorted(zip(grades, successes, trials, strict=True))
    limit: float | None = None
    for grade, count, total in rising:
        if count < ENOUGH * total:
            break
        limit = grade
    reached = [grade for grade, count, _ in rising if count > 0]
    return SlopeLimit(limit, max(reached, default=None), limit == rising[-1][0])
