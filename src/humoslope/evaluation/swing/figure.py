"""Figure of a swing calibration: density of hip flexion in each bin, its percentile, the fit and the prior."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from humoslope.evaluation.swing.fit import Fit, SwingFit
from humoslope.evaluation.swing.samples import SwingSamples
from humoslope.plotting import INK, dress, new_figure, save_figure
from humoslope.slope.swing import PRIOR, SwingCalibration
from humoslope.statistics import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIT, POINT, PRIOR_INK = "#b03a2e", "#1f4e5f", "#8a8a8a"
CLOUD_STEP, COLUMN = 0.004, 0.8
"""Height of a cell of the density, rad, and its width as a share of a bin."""


def draw(samples: SwingSamples, found: SwingFit, fit: Fit, title: str, out: Path) -> None:
    """Writes the figure: samples, percentiles, fit and prior above, residuals below.

    Raises:
        UserError: If it cannot be written.
    """
    figure = new_figure(9.5, 7.5, f"Hip flexion of the swing leg, {title}")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3.2, 1.0))
    _draw_cloud(above, samples, fit)
    _draw_fit(above, found, fit)
    above.set_xlim(*_range(found, fit))
    _draw_residuals(below, found)
    below.set_xlabel("slope of the ground in the heading direction, degrees", fontsize=10, color=INK)
    for axis in (above, below):
        dress(axis, 9)
    save_figure(figure, out)


def _draw_cloud(axis: Axes, samples: SwingSamples, fit: Fit) -> None:
    """Density of the samples, one column for each bin; the darkest cell of a column holds the most samples."""
    from matplotlib.colors import LinearSegmentedColormap

    slope = np.degrees(samples.slope)
    low, high = (math.floor(v / fit.bin_width + 0.5) for v in (slope.min(), slope.max()))
    centres = np.arange(low, high + 1) * fit.bin_width
    edges = np.append(centres, centres[-1] + fit.bin_width) - 0.5 * fit.bin_width
    y = np.arange(samples.flexion.min() - CLOUD_STEP, samples.flexion.max() + 2.0 * CLOUD_STEP, CLOUD_STEP)
    count, _, _ = np.histogram2d(slope, samples.flexion, bins=(edges, y))
    tint = LinearSegmentedColormap.from_list("tint", ["#eef4f6", "#6ba6ba"])
    axis.fill_between([], [], color="#6ba6ba", label=f"{len(samples):,} samples of swing")
    for centre, column in zip(centres, count, strict=True):
        density = np.ma.masked_equal(column[:, None] / max(column.max(), 1.0), 0.0)
        x = centre + fit.bin_width * COLUMN * np.array([-0.5, 0.5])
        axis.pcolormesh(x, y, density, cmap=tint, vmin=0.0, vmax=1.0, rasterized=True)


def _draw_fit(axis: Axes, found: SwingFit, fit: Fit) -> None:
    fitted = found.calibration
    x = np.linspace(*_range(found, fit), 400)
    axis.plot(x, _target(PRIOR, x), color=PRIOR_INK, linewidth=1.3, linestyle="--", label=_named("prior", PRIOR))
    axis.plot(x, _target(fitted, x), color=FIT, linewidth=2.0, label=_named("fit", fitted))
    for used, face in ((True, POINT), (False, "none")):
        points = [(math.degrees(b.slope), b.flexion) for b in found.bins if b.used is used and b.flexion is not None]
        if points:
            name = f"{fit.percentile:g}th percentile" if used else f"left out: fewer than {fit.least_samples} samples"
            axis.plot(*zip(*points, strict=True), "o", color=POINT, markerfacecolor=face, markersize=5, label=name)
    axis.set_ylabel("hip flexion, rad", fontsize=10, color=INK)
    axis.legend(fontsize=9, frameon=False, loc="upper left")


def _draw_residuals(axis: Axes, found: SwingFit) -> None:
    there = [
        (math.degrees(b.slope), 1e3 * residual, b.used)
        for b, residual in zip(found.bins, found.residuals, strict=True)
        if residual is not None
    ]
    axis.axhline(0.0, color=FIT, linewidth=1.5)
    for x, residual, used in there:
        axis.plot([x, x], [0.0, residual], color=POINT, linewidth=1.0, alpha=1.0 if used else 0.4)
        axis.plot(x, residual, "o", color=POINT, markerfacecolor=POINT if used else "none", markersize=4)
    axis.set_ylabel("residual, mrad", fontsize=10, color=INK)
    axis.set_title(f"RMS {1e3 * found.rms_residual:.1f} mrad", fontsize=9, color=INK, loc="right")


def _range(found: SwingFit, fit: Fit) -> tuple[float, float]:
    return found.bins[0].centre - 0.6 * fit.bin_width, found.bins[-1].centre + 0.6 * fit.bin_width


def _target(calibration: SwingCalibration, slope: Array) -> Array:
    target: Array = calibration.target(torch.from_numpy(np.radians(slope))).numpy()
    return target


def _named(name: str, calibration: SwingCalibration) -> str:
    clip = math.degrees(calibration.theta_clip)
    sign = "-" if calibration.beta1 < 0.0 else "+"
    return f"{name}: {calibration.beta0:.3f} rad {sign} {abs(calibration.beta1):.3f} clip(slope, 0, {clip:g}°)"
