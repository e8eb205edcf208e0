"""Intervals say how sure a share is."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.evaluation.statistics import mean, proportion

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


def test_a_mean_is_over_what_was_measured() -> None:
    assert mean(np.array([1.0, np.nan, 3.0])) == 2.0
    assert mean(np.array([np.nan])) is None
