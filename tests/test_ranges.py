"""Ranges declared at parameters and fields, and what they refuse."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.ranges import (
    Finite,
    Limit,
    NotNegative,
    NotNegativeSpan,
    Positive,
    Range,
    Share,
    Span,
    check_fields,
    check_params,
    hints_of,
)
from humoslope.strict import StrictCfg

if TYPE_CHECKING:
    from nowhere import Unknown

anything = st.floats(allow_nan=True, allow_infinity=True)


@given(
    value=anything, low=st.floats(-5.0, 0.0), width=st.floats(0.1, 5.0), ends=st.tuples(st.booleans(), st.booleans())
)
def test_a_range_holds_what_lies_between_its_bounds_and_they_themselves_unless_they_are_open(value, low, width, ends):
    high = low + width
    bounds = Range(low, high, open_low=ends[0], open_high=ends[1])
    assert (value in bounds) == (
        low < value < high or (value == low and not ends[0]) or (value == high and not ends[1])
    )
    assert (low in bounds, high in bounds) == (not ends[0], not ends[1])
    assert (bounds.fault(value) is None) == (value in bounds)


@given(low=anything, high=anything)
def test_a_pair_is_in_a_range_if_both_are_and_the_lowest_comes_first(low, high):
    assert (Range(0.0).fault((low, high)) is None) == (0.0 <= low <= high < math.inf)


@pytest.mark.parametrize(
    ("bounds", "words"),
    [
        (Range(), "a finite number"),
        (Range(0.0), "0 or more"),
        (Range(0.0, open_low=True), "positive"),
        (Range(1.0, open_low=True), "more than 1"),
        (Range(high=2.0), "2 or less"),
        (Range(high=2.0, open_high=True), "less than 2"),
        (Range(0.0, 1.0), "between 0 and 1"),
        (Range(0.0, 1.0, open_low=True), "between 0 and 1, 0 excluded"),
        (Range(0.0, 1.0, open_high=True), "between 0 and 1, 1 excluded"),
        (Range(0.0, 1.0, open_low=True, open_high=True), "between 0 and 1, both excluded"),
        (Range(0.0, open_low=True, infinite=True), "positive, or inf for no limit"),
    ],
)
def test_a_range_is_said_in_words(bounds, words):
    assert str(bounds) == words
    assert bounds.fault("many") == f"it must be {words}"


@dataclass
class Settings(StrictCfg):
    rate: Positive = 1.0
    clip: Limit = math.inf
    times: Span = (0.0, 1.0)
    mode: Literal["a", "b"] = "a"
    plain: float = 0.0
    nested: dict[str, Any] = field(default_factory=dict)
    count: Annotated[int, Range(1)] = 1
    other: Unknown | None = None


@dataclass
class More(Settings):
    share: Share = 0.5


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("rate", 0.0, "settings: rate is 0; it must be positive."),
        ("clip", -math.inf, "settings: clip is -inf; it must be positive, or inf for no limit."),
        ("times", (2.0, 1.0), "settings: times is (2, 1); it must be (lowest, highest), two finite numbers."),
        ("times", (2.0,), "settings: times is (2); it must be (lowest, highest), two finite numbers."),
        ("mode", "c", "settings: mode is 'c'; it must be 'a' or 'b'."),
        ("plain", math.nan, "settings: plain is nan; it must be finite."),
        ("count", 0, "settings: count is 0; it must be 1 or more."),
        ("count", True, "settings: count is True; it must be 1 or more."),
        ("share", 1.5, "settings: share is 1.5; it must be between 0 and 1."),
    ],
)
def test_a_field_outside_its_range_is_refused_in_one_sentence(name, value, said):
    check_fields("settings", More())
    with pytest.raises(UserError) as caught:
        check_fields("settings", More(**{name: value}))
    assert str(caught.value) == said


def function(env: Unknown, level: NotNegative, offset: Finite = 0.0, band: NotNegativeSpan = (0.0, 1.0), free=1.0):
    """Takes parameters of all sorts."""


@pytest.mark.parametrize(
    ("params", "said"),
    [
        ({"level": -1}, "here: level is -1; it must be 0 or more."),
        ({"level": 1, "offset": math.inf}, "here: offset is inf; it must be a finite number."),
        ({"level": 1, "band": (-1.0, 0.0)}, "here: band is (-1, 0); it must be (lowest, highest), each 0 or more."),
        ({"level": 1, "free": math.nan}, "here: free is nan; it must be finite."),
        ({"level": 1, "free": {"a": [0.0, (math.inf,)]}}, "here: free is {'a': [0.0, (inf,)]}; it must be finite."),
    ],
)
def test_a_parameter_outside_its_range_is_refused_in_one_sentence(params, said):
    check_params("here", function, {"level": 0.0})
    with pytest.raises(UserError) as caught:
        check_params("here", function, params)
    assert str(caught.value) == said


def test_a_name_that_only_type_checkers_know_is_no_obstacle():
    assert hints_of(function)["env"] is Any
    assert hints_of(function)["level"] == NotNegative
