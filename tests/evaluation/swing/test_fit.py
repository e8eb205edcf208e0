"""A percentile in every bin of slopes, and the paper's equation through them."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from humoslope.errors import UserError
from humoslope.evaluation.swing.fit import LEAST_LEVEL, LEAST_UPHILL, Fit, SwingFit, gather, solve, table
from humoslope.evaluation.swing.samples import SwingSamples
from humoslope.slope.swing import SwingCalibration
from humoslope.statistics import Array

GRADES = tuple(2.5 * i for i in range(-12, 13))
Z90 = 1.2815515655446004  # 90th percentile of the standard normal distribution
TRUE = SwingCalibration(0.5, 0.8, math.radians(30.0))


def samples_of(slope: Array, flexion: Array) -> SwingSamples:
    return SwingSamples(slope, flexion)


def target(calibration: SwingCalibration, slope: Array) -> Array:
    return calibration.target(torch.from_numpy(slope)).numpy()


def exactly(calibration: SwingCalibration, grades: tuple[float, ...], each: int = 10) -> SwingSamples:
    """Samples that all lie on the reference."""
    slope = np.radians(np.repeat(grades, each))
    return samples_of(slope, target(calibration, slope))


def fit(samples: SwingSamples, **changes: Any) -> SwingFit:
    cfg = Fit(**{"least_samples": 10, **changes})
    return solve(gather(samples, cfg), cfg)


@settings(max_examples=20)
@given(
    beta0=st.floats(0.2, 0.8),
    beta1=st.floats(0.3, 1.5),
    noise=st.floats(0.005, 0.05),
    seed=st.integers(0, 1000),
)
def test_known_coefficients_come_back_within_two_percent(beta0: float, beta1: float, noise: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = SwingCalibration(beta0, beta1, math.radians(30.0))
    slope = np.radians(np.repeat(GRADES, 4000) + rng.normal(0.0, 0.3, 4000 * len(GRADES)))
    # Noise whose 90th percentile is zero, and two samples in a hundred that are nowhere near.
    flexion = target(true, slope) + noise * (rng.normal(size=len(slope)) - Z90)
    wild = rng.random(len(slope))
    flexion = np.where(wild < 0.01, 2.0, np.where(wild > 0.99, -1.0, flexion))
    found = fit(samples_of(slope, flexion)).calibration
    assert found.beta0 == pytest.approx(beta0, rel=0.02)
    assert found.beta1 == pytest.approx(beta1, rel=0.02)


@settings(max_examples=20)
@given(percentile=st.floats(50.0, 99.0), width=st.floats(0.01, 0.3))
def test_of_a_uniform_spread_below_the_reference_the_percentile_keeps_its_share(
    percentile: float, width: float
) -> None:
    spread = np.tile(np.linspace(-width, 0.0, 101), len(GRADES))
    slope = np.radians(np.repeat(GRADES, 101))
    found = fit(samples_of(slope, target(TRUE, slope) + spread), percentile=percentile)
    assert found.calibration.beta0 == pytest.approx(TRUE.beta0 - width * (1.0 - percentile / 100.0), abs=1e-9)
    assert found.calibration.beta1 == pytest.approx(TRUE.beta1, abs=1e-9)
    assert found.rms_residual == pytest.approx(0.0, abs=1e-9)


@given(
    values=st.lists(st.floats(-1.0, 1.0), min_size=len(GRADES), max_size=len(GRADES)),
    theta_clip=st.floats(8.0, 60.0),
)
def test_the_fit_is_the_least_squares_solution_of_the_equation(values: list[float], theta_clip: float) -> None:
    slope = np.radians(np.array(GRADES))
    found = fit(samples_of(slope, np.array(values)), least_samples=1, theta_clip=theta_clip)
    clipped = np.clip(slope, 0.0, math.radians(theta_clip))
    design = np.stack([np.ones_like(clipped), clipped], axis=1)
    expected, *_ = np.linalg.lstsq(design, np.array(values), rcond=None)
    assert [found.calibration.beta0, found.calibration.beta1] == pytest.approx(expected.tolist(), abs=1e-9)
    residuals = np.array(values) - design @ expected
    assert np.array(found.residuals, dtype=float) == pytest.approx(residuals, abs=1e-9)
    assert found.rms_residual == pytest.approx(math.sqrt((residuals**2).mean()), abs=1e-9)
    assert abs(found.worst[0]) == pytest.approx(np.abs(residuals).max(), abs=1e-9)


def test_slopes_beyond_the_clip_say_what_the_steepest_do() -> None:
    found = fit(exactly(TRUE, (*GRADES, 32.5, 35.0, 40.0)))
    assert found.calibration.beta1 == pytest.approx(TRUE.beta1)
    assert found.rms_residual == pytest.approx(0.0, abs=1e-12)


@settings(max_examples=10)
@given(order=st.permutations(range(50)))
def test_the_order_of_samples_does_not_matter(order: list[int]) -> None:
    slope, flexion = np.radians(np.repeat(GRADES, 2)), np.random.default_rng(0).normal(size=50)
    straight = fit(samples_of(slope, flexion), least_samples=2).calibration
    mixed = fit(samples_of(slope[order], flexion[order]), least_samples=2).calibration
    assert mixed.beta0 == pytest.approx(straight.beta0)
    assert mixed.beta1 == pytest.approx(straight.beta1)


def test_a_bin_with_too_few_samples_is_left_out_and_said() -> None:
    few = exactly(SwingCalibration(5.0, 5.0, 0.5), (20.0,), each=9)
    good = exactly(TRUE, tuple(g for g in GRADES if g != 20.0))
    both = samples_of(np.concatenate([good.slope, few.slope]), np.concatenate([good.flexion, few.flexion]))
    found = fit(both)
    assert found.calibration.beta0 == pytest.approx(TRUE.beta0)
    assert found.calibration.beta1 == pytest.approx(TRUE.beta1)
    assert found.rms_residual == pytest.approx(0.0, abs=1e-12)
    (out,) = (b for b in found.bins if not b.used)
    assert (out.centre, out.count) == (20.0, 9)
    (row,) = (line.split() for line in printed(found).splitlines() if "left out" in line)
    assert row[:2] == ["+20", "9"]
    assert " ".join(row[4:]) == "left out: fewer than 10 samples"


def test_a_grade_that_nobody_walked_is_listed_as_empty() -> None:
    cfg = Fit(least_samples=10)
    bins = gather(exactly(TRUE, (0.0, 5.0, 10.0, 15.0)), cfg, grades=(0.0, 20.0, -30.0))
    assert [(b.centre, b.count) for b in bins] == [(-30.0, 0), (0.0, 10), (5.0, 10), (10.0, 10), (15.0, 10), (20.0, 0)]
    assert bins[0].flexion is None
    found = solve(bins, cfg)
    assert found.residuals[0] is None
    assert found.calibration.beta1 == pytest.approx(TRUE.beta1)


def test_bins_are_centred_on_the_ramps() -> None:
    slope = np.radians(np.array([8.76, 9.9, 10.0, 11.24, 11.26]))
    low, high = gather(samples_of(slope, np.array([0.1, 0.2, 0.3, 0.4, 0.5])), Fit())
    assert (low.centre, low.count, high.centre, high.count) == (10.0, 4, 12.5, 1)
    assert low.slope == pytest.approx(np.mean(slope[:4]))


def test_just_enough_bins_are_fitted_and_one_fewer_is_refused_with_the_prior_offered() -> None:
    level, uphill = (0.0, -5.0)[:LEAST_LEVEL], (5.0, 10.0, 15.0, 20.0)[:LEAST_UPHILL]
    assert fit(exactly(TRUE, level + uphill)).calibration.beta1 == pytest.approx(TRUE.beta1)
    for grades in (level + uphill[:-1], level[:-1] + uphill):
        with pytest.raises(UserError, match=r"train Stage II with --calibration prior \(beta0 0.45 rad"):
            fit(exactly(TRUE, grades))


def test_nothing_walked_is_refused_and_not_a_crash() -> None:
    with pytest.raises(UserError, match="0 bins of slopes uphill and 0 others have 10 samples"):
        fit(samples_of(np.empty(0), np.empty(0)))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"percentile": 100.0}, "percentile is 100; it must be between 50 and 100, 100 excluded"),
        ({"percentile": math.nan}, "percentile is nan"),
        ({"bin_width": 0.0}, "bin_width is 0"),
        ({"least_samples": 0}, "least_samples is 0"),
        ({"theta_clip": 90.0}, "theta_clip is 90"),
    ],
)
def test_an_impossible_fit_is_refused_in_one_sentence(change: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said):
        dataclasses.replace(Fit(), **change)


def printed(found: SwingFit) -> str:
    console = Console(width=80)
    with console.capture() as captured:
        console.print(table(found.bins, Fit(least_samples=10), found))
    return captured.get()
