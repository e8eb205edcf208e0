"""The search finds known limits of made-up success curves."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.evaluation.margins.search import GUARDS, Rule, Search


def searched(
    size: int, holds: Callable[[int], bool], known: dict[int, bool] | None = None
) -> tuple[Search, list[int]]:
    search, asked = Search(size, {0: True} if known is None else known), []
    steps = search.run()
    index = next(steps, None)
    while index is not None:
        asked.append(index)
        try:
            index = steps.send(holds(index))
        except StopIteration:
            break
    assert len(set(asked)) == len(asked)
    assert search.tests_left == 0
    return search, asked


@given(size=st.integers(1, 60), data=st.data())
def test_the_limit_of_a_monotone_curve_is_found_with_few_values(size: int, data: st.DataObject) -> None:
    limit = data.draw(st.integers(0, size - 1))
    search, asked = searched(size, lambda i: i <= limit)
    assert search.limit == limit
    assert search.failing == limit + 1
    assert search.monotone
    assert len(asked) <= size.bit_length() + GUARDS + 1


@given(size=st.integers(1, 60), data=st.data())
def test_a_first_value_of_which_nothing_is_known_is_tested_before_all_others(size: int, data: st.DataObject) -> None:
    limit = data.draw(st.integers(-1, size - 1))
    search, asked = searched(size, lambda i: i <= limit, {})
    assert asked[0] == 0
    assert (search.limit, search.failing) == (limit, limit + 1)
    assert search.monotone
    assert len(asked) <= size.bit_length() + GUARDS + 2


def test_nothing_holds_where_all_that_is_tested_fails_and_what_holds_beyond_is_reported() -> None:
    search, asked = searched(21, lambda i: False, {})
    assert (search.limit, search.failing, asked) == (-1, 0, [0, 1])
    assert search.monotone
    assert not searched(21, lambda i: i > 0, {})[0].monotone


@given(limit=st.integers(3, 40), lucky=st.integers(2, 60))
def test_one_lucky_value_beyond_the_limit_does_not_raise_it(limit: int, lucky: int) -> None:
    lucky += limit
    search, asked = searched(64, lambda i: i <= limit or i == lucky)
    assert search.limit == limit
    assert search.monotone == (lucky not in asked)


@given(limit=st.integers(1, 60), unlucky=st.integers(1, 60))
def test_one_failing_value_within_the_limit_is_never_certified_once_it_was_tested(limit: int, unlucky: int) -> None:
    search, asked = searched(64, lambda i: i <= limit and i != unlucky)
    expected = unlucky - 1 if unlucky in asked and unlucky <= limit else limit
    assert search.limit == expected
    assert search.failing == expected + 1
    if expected < limit:  # it is reported if the next value, which is tested, holds
        assert search.monotone == (unlucky == limit)


def test_values_are_judged_by_wilsons_bound_after_as_many_trials_as_it_takes() -> None:
    rule = Rule(trials=256)
    assert rule.looks == (16, 32, 64, 128, 256)
    assert Rule(trials=60).looks == (16, 32, 60)
    # n / (n + z^2) >= 0.95 with z = 1.645 needs n >= 19 z^2 = 51.4
    assert rule.judge(51, 51) is None
    assert rule.judge(52, 52) is True
    assert rule.judge(0, 16) is False
    assert rule.judge(15, 16) is None
    assert rule.judge(246, 256) is False  # 96.1 %, and not shown
    assert Rule(trials=2, confidence=0.5).judge(2, 2) is True
    assert Rule(trials=2, confidence=0.5).judge(1, 2) is False
    with pytest.raises(UserError, match="51 trials cannot show 95 %.*at least 52 are needed"):
        Rule(trials=51)
    with pytest.raises(UserError, match="share is 2"):
        Rule(share=2.0)
