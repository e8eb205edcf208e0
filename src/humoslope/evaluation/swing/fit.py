"""Fit of the swing reference: an upper percentile of hip flexion in every bin of slopes, and the paper's equation
through these by least squares."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from humoslope.errors import UserError
from humoslope.evaluation.swing.samples import SwingSamples
from humoslope.ranges import Checked, Range
from humoslope.slope.swing import PRIOR, SwingCalibration

LEAST_LEVEL = 1
"""Bins at or below zero slope that a fit needs: they determine where the line starts."""
LEAST_UPHILL = 3
"""Bins above zero slope that a fit needs: two determine a line, a third tests it."""


@dataclass(frozen=True)
class Fit(Checked):
    """Settings of the fit.

    Attributes:
        percentile: Percentile of hip flexion within a bin. The paper says "upper" without a number; 90 is ours: a peak
            is wanted, and the maximum would be an outlier.
        bin_width: Width of a bin of slopes, degrees; bins are centred on its multiples. Ours.
        least_samples: Samples below which a bin is left out. 500 are some eighty swings. Ours.
        theta_clip: Slope above which the reference stays level, degrees; not fitted. 30 is the steepest grade of the
            paper's benchmark.
    """

    VERB: ClassVar[str] = "calibrate"

    percentile: Annotated[float, Range(50.0, 100.0, open_high=True)] = 90.0
    bin_width: Annotated[float, Range(0.0, 15.0, open_low=True)] = 2.5
    least_samples: Annotated[int, Range(1)] = 500
    theta_clip: Annotated[float, Range(0.0, 90.0, open_low=True, open_high=True)] = 30.0


@dataclass(frozen=True)
class Bin:
    """Samples of about the same slope.

    Attributes:
        centre: Centre of the bin, degrees.
        count: Number of samples.
        slope: Mean slope of the samples, rad; the centre if there are none.
        flexion: Percentile of their hip flexion, rad; None if there are none.
        used: True if there are enough samples for the fit.
    """

    centre: float
    count: int
    slope: float
    flexion: float | None
    used: bool


@dataclass(frozen=True)
class SwingFit:
    """Fitted coefficients and the quality of the fit.

    Attributes:
        calibration: Coefficients.
        beta0_error, beta1_error: Standard errors from the scatter of the bins about the fit, rad and rad/rad. They
            reflect how well the equation fits this policy, and say nothing about another one.
        bins: All bins, by slope.
        residuals: Flexion of each bin less the fit, rad; None where a bin is empty.
        rms_residual: Root mean square residual of the used bins, rad.
    """

    calibration: SwingCalibration
    beta0_error: float
    beta1_error: float
    bins: tuple[Bin, ...]
    residuals: tuple[float | None, ...]
    rms_residual: float

    @property
    def worst(self) -> tuple[float, float]:
        """Largest residual of the used bins, rad, and the centre of its bin, degrees."""
        used = [(r, b.centre) for b, r in zip(self.bins, self.residuals, strict=True) if b.used and r is not None]
        return max(used, key=lambda pair: abs(pair[0]))


def gather(samples: SwingSamples, fit: Fit, grades: Sequence[float] = ()) -> tuple[Bin, ...]:
    """Bins that hold samples and, even if empty, those of `grades` in degrees; by slope."""
    number = np.floor(np.degrees(samples.slope) / fit.bin_width + 0.5).astype(np.int64)
    wanted = {math.floor(grade / fit.bin_width + 0.5) for grade in grades}
    bins = []
    for i in sorted(wanted.union(number.tolist())):
        here = number == i
        count = int(here.sum())
        bins.append(
            Bin(
                centre=i * fit.bin_width,
                count=count,
                slope=float(samples.slope[here].mean()) if count else math.radians(i * fit.bin_width),
                flexion=float(np.percentile(samples.flexion[here], fit.percentile)) if count else None,
                used=count >= fit.least_samples,
            )
        )
    return tuple(bins)


def solve(bins: Sequence[Bin], fit: Fit) -> SwingFit:
    """Least-squares fit of the paper's equation to the bins with enough samples.

    The equation is level at and below zero slope and above theta_clip, so bins there enter with the clipped slope:
    those of descents all determine beta0. Every bin has the same weight, however many samples it has.

    Raises:
        UserError: If too few bins have enough samples.
    """
    used = [b for b in bins if b.used]
    uphill = sum(b.centre > 0.0 for b in used)
    if len(used) - uphill < LEAST_LEVEL or uphill < LEAST_UPHILL:
        raise UserError(
            f"calibration: {uphill} bins of slopes uphill and {len(used) - uphill} others have {fit.least_samples} "
            f"samples of swing or more; the fit needs {LEAST_UPHILL} and {LEAST_LEVEL}. Take a policy that walks, or "
            f"more --starts or --seconds, or train Stage II with --calibration prior (beta0 {PRIOR.beta0:g} rad, beta1 "
            f"{PRIOR.beta1:g}, theta_clip {math.degrees(PRIOR.theta_clip):g} degrees)."
        )
    from scipy.stats import linregress  # takes a second to import, and few verbs fit anything

    clip = math.radians(fit.theta_clip)
    found = linregress([_clipped(b, clip) for b in used], [b.flexion for b in used])
    calibration = SwingCalibration(float(found.intercept), float(found.slope), clip)
    residuals = tuple(_residual(b, calibration) for b in bins)
    left = np.array([r for b, r in zip(bins, residuals, strict=True) if b.used])
    return SwingFit(
        calibration=calibration,
        beta0_error=float(found.intercept_stderr),
        beta1_error=float(found.stderr),
        bins=tuple(bins),
        residuals=residuals,
        rms_residual=float(np.sqrt(np.square(left).mean())),
    )


def _clipped(b: Bin, clip: float) -> float:
    return float(np.clip(b.slope, 0.0, clip))


def _residual(b: Bin, calibration: SwingCalibration) -> float | None:
    if b.flexion is None:
        return None
    return b.flexion - calibration.beta0 - calibration.beta1 * _clipped(b, calibration.theta_clip)


def table(bins: Sequence[Bin], fit: Fit, found: SwingFit | None) -> Table:
    """Table of the bins, with their residuals if there is a fit."""
    table = Table(title="Hip flexion in swing", box=SIMPLE_HEAD, collapse_padding=True, pad_edge=False)
    for column in ("slope\n°", "\nsamples", f"p{fit.percentile:g}\nrad", "residual\nrad"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("")
    residuals = found.residuals if found else (None,) * len(bins)
    for b, residual in zip(bins, residuals, strict=True):
        table.add_row(
            f"{b.centre:+g}" if b.centre else "0",
            str(b.count),
            "-" if b.flexion is None else f"{b.flexion:.3f}",
            "-" if residual is None else f"{residual:+.4f}",
            "" if b.used else f"left out: fewer than {fit.least_samples} samples",
            style=None if b.used else "dim",
        )
    return table
