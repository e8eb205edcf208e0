"""Intervals say how sure a share is."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.statistics import average, mean, proportion

Z = 1.959963984540054  # two-sided 95 % of the normal distribution

trials = st.integers(1, 2000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))


@given(trials)
def test_the_interval_is_wilsons(counted: tuple[int, int]) -> None:
    count, total = counted
    p = count / total
    centre = (p + Z**2 / (2 * total)) / (1 + Z**2 / total)
    half = Z / (1 + Z**2 / total) * math.sqrt(p * (1 - p) / total + Z**2 / (4 * total**2))
    found = proportion(count, total)
    assert found.low == pytest.approx(centre - half, abs=1e-12)
    assert found.high == pytest.approx(centre + half, abs=1e-12)


@given(trials)
def test_the_interval_holds_the_observed_share_and_mirrors_with_its_complement(counted: tuple[int, int]) -> None:
    count, total = counted
    found, other = proportion(count, total), proportion(total - count, total)
    assert 0.0 <= found.low <= found.share + 1e-12
    assert found.share - 1e-12 <= found.high <= 1.0
    assert found.low == pytest.approx(1.0 - other.high, abs=1e-12)


def test_no_fall_in_256_trials_leaves_one_and_a_half_percent_possible() -> None:
    found = proportion(0, 256)
    assert (found.share, found.low) == (0.0, 0.0)
    assert found.high == pytest.approx(Z**2 / (256 + Z**2))


@pytest.mark.parametrize(("count", "total"), [(0, 0), (3, 2), (-1, 4)])
def test_impossible_counts_are_refused(count: int, total: int) -> None:
    with pytest.raises(UserError, match="at least one"):
        proportion(count, total)


def test_the_interval_of_an_average_is_students() -> None:
    # Two-sided 95 % of Student's t with 3 degrees of freedom, from a printed table.
    found = average(np.array([1.0, 2.0, np.nan, 3.0, 4.0]))
    assert (found.mean, found.trials, found.std) == (2.5, 4, pytest.approx(math.sqrt(5.0 / 3.0)))
    half = 3.182446 * math.sqrt(5.0 / 3.0) / 2.0
    assert (found.low, found.high) == pytest.approx((2.5 - half, 2.5 + half), abs=1e-5)


def test_the_interval_holds_the_true_mean_as_often_as_it_says() -> None:
    rng = np.random.default_rng(0)
    found = [average(rng.normal(0.67, 0.01, size=8), confidence=0.9) for _ in range(2000)]
    # The count has a standard deviation of 13.
    assert abs(sum(a.low < 0.67 < a.high for a in found) - 1800) < 60


def test_of_one_trial_there_is_no_interval_and_of_none_no_average() -> None:
    found = average(np.array([np.nan, 3.0]))
    assert (found.mean, found.trials, found.std, found.low, found.high) == (3.0, 1, None, None, None)
    assert average(np.array([np.nan])) is None


def test_trials_that_are_all_alike_have_an_interval_without_width() -> None:
    found = average(np.full(5, 31.5))
    assert (found.low, found.mean, found.high) == (31.5, 31.5, 31.5)


def test_a_mean_is_over_what_was_measured() -> None:
    assert mean(np.array([1.0, np.nan, 3.0])) == 2.0
    assert mean(np.array([np.nan])) is None
