"""The slope limit is the last grade of an unbroken climb."""

from __future__ import annotations

import pytest

from humoslope.evaluation.track.sweep import SlopeLimit, slope_limit


@pytest.mark.parametrize(
    ("successes", "expected"),
    [
        ((4, 4, 2, 1), SlopeLimit(12.0, 13.0, False)),
        ((4, 1, 4, 0), SlopeLimit(10.0, 12.0, False)),  # a steeper grade that happens to go well does not count
        ((1, 4, 4, 4), SlopeLimit(None, 13.0, False)),
        ((0, 0, 0, 0), SlopeLimit(None, None, False)),
        ((4, 4, 4, 2), SlopeLimit(13.0, 13.0, True)),
    ],
)
def test_the_climb_stops_at_the_first_grade_that_is_not_mastered(
    successes: tuple[int, ...], expected: SlopeLimit
) -> None:
    grades = (10.0, 11.0, 12.0, 13.0)
    assert slope_limit(grades, successes, (4,) * 4) == expected
    assert slope_limit(grades[::-1], successes[::-1], (4,) * 4) == expected
