"""The search finds known limits of made-up success curves."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from humoslope.errors import UserError
from humoslope.evaluation.margins.search import GUARDS, Rule, Search


def searched(size: int, holds: Callable[[int], bool], known: dict[int, bool] | None = None) -> tuple[Search, list[int]]:
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


def chance_to_hold(rule: Rule, share: float) -> float:
    """Probability that a value with this true share of successes is shown to hold, by all ways to get there."""
    open_, before, held = np.ones(1), 0, 0.0  # probability of so many successes, with no verdict so far
    for look in rule.looks:
        more = look - before
        open_ = np.convolve(open_, binom.pmf(np.arange(more + 1), more, share))
        verdicts = [rule.judge(successes, look) for successes in range(look + 1)]
        held += open_[[verdict is True for verdict in verdicts]].sum()
        open_, before = np.where([verdict is None for verdict in verdicts], open_, 0.0), look
    assert open_.sum() == 0.0  # there is a verdict in the end
    return float(held)


@pytest.mark.parametrize("trials", [59, 128, 129, 256, 1024])
def test_a_value_of_just_the_share_is_certified_as_seldom_as_is_promised_over_all_looks(trials: int) -> None:
    rule = Rule(trials=trials)
    assert chance_to_hold(rule, 0.95) <= 0.05
    assert chance_to_hold(rule, 0.94) < chance_to_hold(rule, 0.95) < chance_to_hold(rule, 0.99)


@given(trials=st.integers(1, 100), share=st.floats(0.05, 0.99), confidence=st.floats(0.5, 0.99))
def test_the_confidence_is_kept_for_every_rule(trials: int, share: float, confidence: float) -> None:
    enough = math.ceil(math.log(1.0 - confidence) / math.log(share))
    rule = Rule(trials=max(trials, enough + 1), share=share, confidence=confidence)
    assert chance_to_hold(rule, share) <= 1.0 - confidence + 1e-9


def test_what_passes_easily_is_certified_after_128_trials() -> None:
    rule = Rule()
    assert rule.looks == (16, 32, 64, 128, 256)
    assert rule.decisive == (128, 256)  # 0.95 ** 64 is 0.0375, more than a third of 0.05
    assert rule.judge(64, 64) is None
    assert rule.judge(127, 128) is True
    assert chance_to_hold(rule, 0.999) > 0.999


def test_values_are_judged_by_the_exact_bound_after_as_many_trials_as_it_takes() -> None:
    rule = Rule(trials=256)
    assert Rule(trials=60).looks == (16, 32, 60)
    assert Rule(trials=60).decisive == (60,)
    assert rule.judge(0, 16) is False
    assert rule.judge(15, 16) is None
    # Of 128 trials with a share of 0.95, 127 and more succeed with 0.0109, 126 and more with 0.0428.
    assert (rule.judge(127, 128), rule.judge(126, 128)) == (True, None)
    assert rule.lower(126, 128) < 0.95 < rule.lower(127, 128)
    assert rule.judge(251, 256) is True
    assert rule.judge(250, 256) is False  # 97.7 %, and not shown
    assert binom.sf(250, 256, 0.95) < 0.025 < binom.sf(249, 256, 0.95)
    for successes, trials in ((10, 16), (127, 128), (0, 5), (5, 5)):
        lower, upper = rule.lower(successes, trials), rule.upper(successes, trials)
        assert successes == 0 or binom.sf(successes - 1, trials, lower) == pytest.approx(0.025)
        assert successes == trials or binom.cdf(successes, trials, upper) == pytest.approx(0.025)
    assert Rule(trials=2, share=0.7, confidence=0.5).judge(2, 2) is True
    assert Rule(trials=2, share=0.7, confidence=0.5).judge(1, 2) is False


def test_a_rule_that_can_show_nothing_is_refused_with_the_trials_that_it_takes() -> None:
    with pytest.raises(UserError, match="58 trials cannot show a share of 0.95 .*at least 59 are needed"):
        Rule(trials=58)
    assert Rule(trials=59).judge(59, 59) is True
    with pytest.raises(UserError, match="a share of 0.9999999 .*at least 29957322 are needed"):
        Rule(share=0.9999999)
    with pytest.raises(UserError, match="share is 2"):
        Rule(share=2.0)
