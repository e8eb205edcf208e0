"""Learning curves of several seeds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from humoslope.errors import UserError
from humoslope.evaluation.report.compare import Curves, TrainingRun, grouped, read_all
from humoslope.evaluation.report.curve import PANELS, STEPS, Panel, smooth
from humoslope.evaluation.report.figures import COLOURS
from humoslope.plotting import INK, dress, new_figure, save_figure
from humoslope.statistics import Array

SHOWN = (*PANELS, Panel("Train/speed", "speed, m/s"))


def draw_bands(runs: Sequence[TrainingRun], out: Path, at: float = 0.0) -> None:
    """Writes a figure of the learning curves: of each method the mean over its seeds, in a band from the lowest to the
    highest seed.

    Args:
        at: Environment steps at which the curves end; 0 for those of the shortest seed of each method.

    Raises:
        UserError: If a run has no curves, or the figure cannot be written.
    """
    curves, _ = read_all(runs, at)
    panels = [panel for panel in SHOWN if all(panel.tag in of_run for of_run in curves)]
    if not panels:
        raise UserError(f"the curves of these runs have none of {', '.join(p.tag for p in SHOWN)} in common.")
    columns = min(2, len(panels))
    rows = -(-len(panels) // columns)
    figure = new_figure(5.5 * columns, 1.1 + 2.5 * rows, "Mean over seeds, from the lowest to the highest one")
    axes = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    for axis, panel in zip(axes, panels, strict=False):
        for i, (name, places) in enumerate(grouped(runs).items()):
            steps, mean, low, high = band([curves[k] for k in places], panel.tag, at or math.inf)
            colour = COLOURS[i % len(COLOURS)]
            axis.plot(steps / 1e6, mean, color=colour, linewidth=1.8, label=f"{name} ({len(places)})")
            axis.fill_between(steps / 1e6, low, high, color=colour, alpha=0.18, linewidth=0.0)
        axis.set_title(panel.title, fontsize=10, color=INK, loc="left")
        bottom, top = axis.get_ylim()
        axis.set_ylim(bottom if panel.low is None else panel.low, top if panel.high is None else panel.high)
        axis.margins(x=0.01)
        dress(axis)
    figure.supxlabel("environment steps, million", fontsize=10, color=INK)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    save_figure(figure, out)


def band(
    curves: Sequence[Curves], tag: str, at: float = math.inf, points: int = 200
) -> tuple[Array, Array, Array, Array]:
    """Mean, lowest and highest of smoothed curves.

    Returns:
        Environment steps up to `at` or the end of the shortest curve, and the three there; all [points].
    """
    ends = [max(of_run[STEPS].values()) for of_run in curves]
    starts = [min(of_run[STEPS].values()) for of_run in curves]
    steps = np.linspace(max(starts), min(at, *ends), points)
    lines = []
    for of_run in curves:
        there = [i for i in of_run[tag] if i in of_run[STEPS]]
        y = np.array([of_run[tag][i] for i in there])
        x = np.array([of_run[STEPS][i] for i in there])
        lines.append(np.interp(steps, x, smooth(y, max(1, len(y) // 60))))
    stacked = np.stack(lines)
    return steps, stacked.mean(axis=0), stacked.min(axis=0), stacked.max(axis=0)
