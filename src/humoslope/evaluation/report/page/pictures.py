"""Pictures of the page, as data that stands in it."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from humoslope.evaluation.report.curve import PANELS, STEPS, Curve, smooth
from humoslope.evaluation.report.figures import COLOURS, MARKERS, draw_all
from humoslope.evaluation.report.results import Result
from humoslope.files import temporary_folder
from humoslope.plotting import INK, dress, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 110


def uri(png: bytes) -> str:
    """A PNG as an address that needs no file."""
    return f"data:image/png;base64,{base64.b64encode(png).decode()}"


def of_file(write: Callable[[Path], object]) -> str:
    """The picture that `write` puts into a file."""
    with temporary_folder() as folder:
        path = folder / "picture.png"
        write(path)
        return uri(path.read_bytes())


def of_results(results: Sequence[Result], grade: float) -> dict[str, str]:
    """The figures of `humoslope figures` by their names."""
    with temporary_folder() as folder:
        return {path.stem: uri(path.read_bytes()) for path in draw_all(results, folder, grade)}


def of_curves(runs: Mapping[str, Mapping[str, Curve]]) -> str | None:
    """Learning curves of runs by their names, a panel for each curve that one of them has; None if there is none."""
    panels = [p for p in PANELS if any(p.tag in curves and STEPS in curves for curves in runs.values())]
    if not panels:
        return None
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure = new_figure(4.3 * columns, 0.7 + 2.3 * rows)
    axes = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    for axis, panel in zip(axes, panels, strict=False):
        for i, (name, curves) in enumerate(runs.items()):
            steps, curve = curves.get(STEPS, {}), curves.get(panel.tag, {})
            there = [iteration for iteration in curve if iteration in steps]
            x, y = np.array([steps[n] for n in there]) / 1e6, np.array([curve[n] for n in there])
            axis.plot(x, y, color=_colour(i), linewidth=0.6, alpha=0.3)
            axis.plot(x, smooth(y, max(1, len(y) // 60)), color=_colour(i), linewidth=1.6, label=name)
        if panel.low is not None or panel.high is not None:
            axis.set_ylim(panel.low, panel.high)
        axis.set_title(panel.title, fontsize=9, color=INK, loc="left")
        dress(axis)
    for axis in axes[max(0, len(panels) - columns) : len(panels)]:
        axis.set_xlabel("environment steps, million", fontsize=8, color=INK)
        axis.tick_params(labelbottom=True)  # also above an empty place
    return _finish(figure, axes[0], len(runs))


def of_ramps(reports: Mapping[str, Mapping[str, Any]]) -> str:
    """Falls and speed of policies by their names on each ramp; bars are Wilson's 95 % intervals."""
    figure = new_figure(9.0, 3.2)
    falls, speed = figure.subplots(1, 2)
    for i, (name, report) in enumerate(reports.items()):
        ramps = sorted(report["ramps"], key=lambda r: r["grade"])
        grades = [r["grade"] for r in ramps]
        share = np.array([100.0 * r["falls"]["count"] / r["falls"]["total"] for r in ramps])
        bounds = np.array([[100.0 * r["falls"][end] for r in ramps] for end in ("low", "high")])
        bars = np.abs(bounds - share)
        style: dict[str, Any] = {"color": _colour(i), "marker": MARKERS[i % len(MARKERS)], "markersize": 4.0}
        falls.errorbar(grades, share, bars, linewidth=1.3, capsize=2.0, label=name, **style)
        walked = [(r["grade"], r["speed"]) for r in ramps if r["speed"] is not None]
        speed.plot(*np.array(walked).reshape(-1, 2).T, linewidth=1.3, label=name, **style)
        asked = report["protocol"]["speed"]
        speed.axhline(asked, color=INK, linewidth=0.8, linestyle=":")
    for axis, title in ((falls, "falls, %"), (speed, "speed, m/s; dotted: commanded")):
        axis.set_title(title, fontsize=9, color=INK, loc="left")
        axis.set_xlabel("grade, degrees", fontsize=9, color=INK)
        dress(axis)
    falls.set_ylim(-4.0, 104.0)
    return _finish(figure, falls, len(reports))


def _colour(i: int) -> str:
    return COLOURS[i % len(COLOURS)]


def _finish(figure: Figure, axis: Axes, count: int) -> str:
    if count > 1:
        handles, labels = axis.get_legend_handles_labels()
        figure.legend(
            handles,
            labels,
            loc="outside lower center",
            ncols=min(count, 4),
            fontsize=8.5,
            frameon=False,
            labelcolor=INK,
        )
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    return uri(buffer.getvalue())
