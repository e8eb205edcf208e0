"""Ranges declared at parameters and fields, and what they refuse."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.ranges import (
    LARGEST,
    SMALLEST,
    Finite,
    Limit,
    NotEmpty,
    NotNegative,
    NotNegativeSpan,
    Positive,
    Range,
    Share,
    Span,
    check_config,
    check_params,
    hints_of,
    in_words,
)
from humoslope.strict import StrictCfg

if TYPE_CHECKING:
    from nowhere import Unknown

anything = st.floats(allow_nan=True, allow_infinity=True)


def sized(value):
    return value == 0.0 or abs(value) >= SMALLEST


@given(
    value=anything, low=st.floats(-5.0, 0.0), width=st.floats(0.1, 5.0), ends=st.tuples(st.booleans(), st.booleans())
)
def test_a_range_holds_what_lies_between_its_bounds_and_they_themselves_unless_they_are_open(value, low, width, ends):
    high = low + width
    bounds = Range(low, high, open_low=ends[0], open_high=ends[1])
    assert (value in bounds) == (
        sized(value) and (low < value < high or (value == low and not ends[0]) or (value == high and not ends[1]))
    )
    assert (low in bounds, high in bounds) == (not ends[0] and sized(low), not ends[1] and sized(high))
    assert (bounds.fault(value) is None) == (value in bounds)


@given(low=anything, high=anything)
def test_a_pair_is_in_a_range_if_both_are_and_the_lowest_comes_first(low, high):
    assert (Range(0.0).fault((low, high)) is None) == (0.0 <= low <= high <= LARGEST and sized(low) and sized(high))


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
        (Range(1, 1_000_000), "between 1 and 1,000,000"),
    ],
)
def test_a_range_is_said_in_words(bounds, words):
    assert str(bounds) == words
    assert bounds.fault("many") == f"it must be {words} (not a number)"


PAIR = "it must be (lowest, highest), two finite numbers"
SIZED = "of a size between 1e-09 and 1,000,000"


@dataclass
class Inner(StrictCfg):
    share: Share = 0.5


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
    widths: Annotated[tuple[Annotated[int, Range(1, 64)], ...], NotEmpty()] = (8,)
    shares: Mapping[str, NotNegative] = field(default_factory=dict)
    perhaps: Positive | None = None
    inner: Inner = field(default_factory=Inner)
    terms: dict[str, Inner] = field(default_factory=dict)
    text: str = ""


@dataclass
class More(Settings):
    share: Share = 0.5


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("rate", 0.0, "settings.rate is 0; it must be positive (too low)."),
        ("clip", -math.inf, "settings.clip is -inf; it must be positive, or inf for no limit (too low)."),
        (
            "times",
            (2.0, 1.0),
            "settings.times is (2, 1); it must be (lowest, highest), two finite numbers (the first is higher).",
        ),
        ("times", (2.0,), f"settings.times is (2); {PAIR} (not two numbers)."),
        ("mode", "c", "settings.mode is 'c'; it must be 'a' or 'b'."),
        ("plain", math.nan, "settings.plain is nan; it must be finite."),
        ("count", 0, "settings.count is 0; it must be 1 or more (too low)."),
        ("count", True, "settings.count is True; it must be a whole number."),
        (
            "count",
            10**400,
            f"settings.count is about 1e400; it must be 1 or more, {SIZED} (too large).",
        ),
        ("rate", math.nan, "settings.rate is nan; it must be positive (not finite)."),
        ("count", 1.5, "settings.count is 1.5; it must be a whole number."),
        ("count", 8.0, "settings.count is 8; it must be a whole number."),
        ("rate", "many", "settings.rate is 'many'; it must be positive (not a number)."),
        (
            "rate",
            1e300,
            f"settings.rate is 1e+300; it must be positive, {SIZED} (too large).",
        ),
        (
            "rate",
            1e-300,
            f"settings.rate is 1e-300; it must be positive, {SIZED} (too close to zero).",
        ),
        ("widths", (), "settings.widths is (); it must have at least one."),
        ("widths", (8, 0), "settings.widths is (8, 0); of each, it must be between 1 and 64 (too low)."),
        ("widths", 8, "settings.widths is 8; it must be a list."),
        ("shares", {"a": -1.0}, "settings.shares is {'a': -1.0}; of 'a', it must be 0 or more (too low)."),
        ("perhaps", -1.0, "settings.perhaps is -1; it must be positive (too low)."),
        ("inner", Inner(2.0), "settings.inner.share is 2; it must be between 0 and 1 (too high)."),
        ("terms", {"one": Inner(-1.0)}, "settings.terms.one.share is -1; it must be between 0 and 1 (too low)."),
        ("mode", "c" * 99, f"settings.mode is 'c{'c' * 58}...; it must be 'a' or 'b'."),
        ("text", 3, "settings.text is 3; it must be a text."),
        ("share", 1.5, "settings.share is 1.5; it must be between 0 and 1 (too high)."),
    ],
)
def test_a_field_outside_its_range_is_refused_in_one_sentence(name, value, said):
    check_config("settings", More())
    with pytest.raises(UserError) as caught:
        check_config("settings", More(**{name: value}))
    assert str(caught.value) == said


def function(env: Unknown, level: NotNegative, offset: Finite = 0.0, band: NotNegativeSpan = (0.0, 1.0), free=1.0):
    """Takes parameters of all sorts."""


@pytest.mark.parametrize(
    ("params", "said"),
    [
        ({"level": -1}, "here: level is -1; it must be 0 or more (too low)."),
        ({"level": 1, "offset": math.inf}, "here: offset is inf; it must be a finite number (not finite)."),
        (
            {"level": 1, "band": (-1.0, 0.0)},
            "here: band is (-1, 0); it must be (lowest, highest), each 0 or more (too low).",
        ),
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


def test_ranges_of_all_sorts_of_fields_are_said_in_words():
    said = {name: in_words(hint) for name, hint in hints_of(More).items()}
    assert (said["rate"], said["count"], said["share"]) == ("positive", "1 or more", "between 0 and 1")
    assert (said["times"], said["widths"], said["shares"]) == (
        "each a finite number",
        "each between 1 and 64",
        "each 0 or more",
    )
    assert (said["perhaps"], said["clip"], said["text"]) == ("positive", "positive, or inf for no limit", "")
