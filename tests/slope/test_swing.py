"""The swing reference is the paper's equation: level downhill, a line uphill, level again when it is too steep."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.slope.swing import PRIOR, SwingCalibration

coefficient = st.floats(-2.0, 2.0)
angle = st.floats(-1.5, 1.5)


@given(beta0=coefficient, beta1=coefficient, clip=st.floats(0.01, 1.5), slope=angle)
def test_the_target_is_the_papers_equation(beta0: float, beta1: float, clip: float, slope: float) -> None:
    target = SwingCalibration(beta0, beta1, clip).target(torch.tensor([slope], dtype=torch.float64))
    assert target.item() == pytest.approx(beta0 + beta1 * min(max(slope, 0.0), clip), abs=1e-12)


def test_the_prior_lifts_the_leg_by_as_much_as_the_ground_rises() -> None:
    slope = torch.deg2rad(torch.tensor([[-30.0, 0.0], [15.0, 45.0]], dtype=torch.float64))
    expected = [[0.45, 0.45], [0.45 + math.radians(15.0), 0.45 + math.radians(30.0)]]
    assert PRIOR.target(slope).tolist() == [pytest.approx(row) for row in expected]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ((math.nan, 1.0, 0.5), "beta0 is nan; it must be finite"),
        ((0.4, math.inf, 0.5), "beta1 is inf; it must be finite"),
        ((0.4, 1.0, 0.0), "theta_clip is 0 rad"),
        ((0.4, 1.0, 30.0), "theta_clip is 30 rad; it must be between 0 and pi/2"),
        ((0.4, 1.0, math.nan), "theta_clip is nan rad"),
    ],
)
def test_impossible_coefficients_are_refused(values: tuple[float, float, float], said: str) -> None:
    with pytest.raises(UserError, match=said):
        SwingCalibration(*values)
