"""Differences over control steps."""

from __future__ import annotations

import torch
from hypothesis import given
from hypothesis import strategies as st

from humoslope.mdp.rate import RateOfChange


@given(slope=st.floats(-100.0, 100.0), start=st.floats(-10.0, 10.0), dt=st.floats(0.005, 0.05))
def test_a_steady_change_has_its_rate_from_the_second_step_on(slope, start, dt):
    rate = RateOfChange(dt)
    values = [torch.full((3, 2), start + slope * dt * k, dtype=torch.float64) for k in range(4)]
    assert rate(values[0]).count_nonzero() == 0
    for value in values[1:]:
        torch.testing.assert_close(rate(value), torch.full((3, 2), slope, dtype=torch.float64), atol=1e-6, rtol=1e-6)


def test_the_jump_of_a_reset_is_no_change_and_the_next_step_counts_again(mask):
    rate = RateOfChange(0.1)
    rate(torch.zeros(3))
    rate.reset(mask(3, 0))
    assert rate(torch.full((3,), 5.0)).tolist() == [0.0, 50.0, 50.0]
    assert rate(torch.full((3,), 6.0)).tolist() == [10.0, 10.0, 10.0]


def test_two_resets_before_the_next_step_both_count(mask):
    rate = RateOfChange(0.1)
    rate(torch.zeros(3))
    rate.reset(mask(3, 0))
    rate.reset(mask(3, 2))
    assert rate(torch.ones(3)).tolist() == [0.0, 10.0, 0.0]


def test_a_reset_before_the_first_step_changes_nothing(mask):
    rate = RateOfChange(0.1)
    rate.reset(mask(3, 1))
    assert rate(torch.ones(3)).tolist() == [0.0, 0.0, 0.0]
    assert rate(torch.full((3,), 2.0)).tolist() == [10.0, 10.0, 10.0]
