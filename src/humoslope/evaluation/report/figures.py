"""Figures of several methods on the held-out track (paper, section 4)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from humoslope.errors import UserError
from humoslope.evaluation.report.results import Result
from humoslope.evaluation.track.metrics import BIN
from humoslope.evaluation.track.summary import Summary
from humoslope.plotting import INK, dress, new_figure, save_figure
from humoslope.statistics import Array, Average, Proportion

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GROUND = "#d9d2c5"
COLOURS = ("#1f6f8b", "#c8553d", "#6a994e", "#8d6a9f", "#d99a2b", "#5c677d", "#a3506b", "#3d8c84")
"""Distinguishable, also for the colour-blind, in this order."""
MARKERS = "osD^vPX*"
SHADES = {1: "#f3e3d7", -1: "#dde8ee"}
"""Background of the segments that go up and down."""

LEAST_SPAN = 0.1
"""Least extent of an axis of heights, m: millimetres should not look like a change of posture."""


def draw_all(results: Sequence[Result], folder: Path, grade: float) -> list[Path]:
    """Writes every figure.

    Args:
        folder: Destination.
        grade: Grade of the figure along the track, degrees.

    Returns:
        The files written.

    Raises:
        UserError: If a figure cannot be written, or there is nothing to draw.
    """
    walked = [result for result in results if result.grades]
    if not walked:
        raise UserError("there is nothing to draw: these results hold no trials on the track, only sweeps.")
    drawings: dict[str, Callable[[Figure], None]] = {
        "com_height": partial(com_height_by_grade, walked),
        "success": partial(success_by_grade, walked),
        "survival": partial(survival, walked),
    }
    if any(result.at(grade) for result in walked):
        drawings["along_track"] = partial(along_track, walked, grade)
    return [_write(draw, folder / f"{name}.png") for name, draw in drawings.items()]


def _com_height(summary: Summary) -> Average | None:
    height = summary.get("com_height")
    return height if isinstance(height, Average) else None


def _success(summary: Summary) -> Proportion:
    rate = summary["success"]
    assert isinstance(rate, Proportion)
    return rate


def com_height_by_grade(results: Sequence[Result], figure: Figure) -> None:
    """Mean height of the centre of mass above the ground; bars are one standard deviation between trials."""
    figure.set_size_inches(6.2, 4.0)
    axis = figure.subplots()
    for i, result in enumerate(results):
        there = [(g.grade, height) for g in result.grades if (height := _com_height(g.summary)) is not None]
        x = _aside([grade for grade, _ in there], i, len(results), 0.5)
        y = [height.mean for _, height in there]
        spread = [_number(height.std) for _, height in there]
        _points(axis, i, x, y, spread, _label(result))
    axis.set_xticks(sorted({g.grade for result in results for g in result.grades}))
    low, high = axis.get_ylim()
    spare = max(0.0, 0.5 * (LEAST_SPAN - (high - low)))
    axis.set_ylim(low - spare, high + spare)
    _label_axis(axis, "nominal grade, degrees", "m", "Centre of mass above the ground, mean and deviation of trials")
    _legend(figure, axis)


def success_by_grade(results: Sequence[Result], figure: Figure) -> None:
    """Success rate at each grade, a panel for each friction tier; bars are Wilson's 95 % intervals."""
    tiers = sorted({cell.tier for result in results for cell in result.cells})
    grades = sorted({cell.grade for result in results for cell in result.cells})
    figure.set_size_inches(max(5.0, 3.3 * len(tiers)), 3.6)
    axes = figure.subplots(1, len(tiers), sharex=True, sharey=True, squeeze=False)[0]
    for axis, tier in zip(axes, tiers, strict=True):
        for i, result in enumerate(results):
            cells = sorted((c for c in result.cells if c.tier == tier), key=lambda c: c.grade)
            x = _aside([c.grade for c in cells], i, len(results), 0.9)
            y, bars = _percent([_success(c.summary) for c in cells])
            _points(axis, i, x, y, bars, _label(result))
        axis.set_xticks(grades)
        axis.set_ylim(-4, 104)
        unit = "success, %" if axis is axes[0] else ""
        _label_axis(axis, "nominal grade, degrees", unit, f"friction tan(grade) + {tier:g}")
    _legend(figure, axes[0])


def survival(results: Sequence[Result], figure: Figure) -> None:
    """Share of trials that got at least as far as each place, a panel for each grade."""
    grades = sorted({g.grade for result in results for g in result.grades})
    columns = min(4, len(grades))
    rows = -(-len(grades) // columns)
    figure.set_size_inches(max(5.0, 3.0 * columns), 0.9 + 2.6 * rows)
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axis in axes[len(grades) :]:
        axis.set_visible(False)
    for axis, grade in zip(axes, grades, strict=False):
        for i, result in enumerate(results):
            if (there := result.at(grade)) is None:
                continue
            y = 100.0 * np.array(there.reached) / _success(there.summary).total
            goal = np.arange(len(y)) * BIN <= result.goal + 1e-6  # trials end there
            axis.plot(BIN * np.arange(len(y))[goal], y[goal], color=_colour(i), linewidth=1.8, label=_label(result))
        for goal_line in {result.goal for result in results}:
            axis.axvline(goal_line, color=INK, linewidth=0.8, linestyle=":")
        if grade > 0.0:
            _shade(axis, results[0])
        axis.set_xlim(0.0, max(result.goal for result in results) + 0.5)
        axis.set_ylim(-4, 104)
        _label_axis(axis, "place, m", "trials, %" if axis is axes[0] else "", f"{grade:g}°")
    figure.suptitle("Trials that got at least this far; dotted: the goal", fontsize=11, color=INK)
    _legend(figure, axes[0])


def along_track(results: Sequence[Result], grade: float, figure: Figure) -> None:
    """Hip torque and knee flexion along the track at one grade, over its profile."""
    figure.set_size_inches(9.5, 5.6)
    axes = figure.subplots(3, 1, sharex=True, height_ratios=(1.0, 2.0, 2.0))
    there = [(i, result, at) for i, result in enumerate(results) if (at := result.at(grade)) is not None]
    _ground(axes[0], there[0][1], grade)
    panels = (
        ("hip_torque", 1.0, "Nm", "Hip pitch torque, mean of |torque| of one joint"),
        ("knee_flexion", math.degrees(1.0), "degrees", "Knee flexion"),
    )
    for axis, (name, factor, unit, title) in zip(axes[1:], panels, strict=True):
        for i, result, at in there:
            y = factor * np.array([_number(value) for value in at.profile[name]])
            x = BIN * (np.arange(len(y)) + 0.5)
            shown = x < result.goal  # beyond, there is the last control step of a success and nothing else
            axis.plot(x[shown], y[shown], color=_colour(i), linewidth=1.8, label=_label(result))
        _shade(axis, there[0][1])
        _label_axis(axis, "", unit, title)
    axes[-1].set_xlabel("place along the track, m", fontsize=9, color=INK)
    axes[-1].set_xlim(0.0, sum(segment.length for segment in there[0][1].segments))
    figure.suptitle(f"Along the track at {grade:g}°, mean over all trials that got there", fontsize=11, color=INK)
    _legend(figure, axes[1])


def _ground(axis: Axes, result: Result, grade: float) -> None:
    """Profile of the track without its surfaces, with the names of its segments."""
    ends = [0.0, *accumulate(segment.length for segment in result.segments)]
    rises = (s.length * s.direction * math.tan(math.radians(grade)) for s in result.segments)
    heights = [0.0, *accumulate(rises)]
    low, high = min(heights), max(heights)
    room = 0.25 * (high - low) + 0.5
    axis.fill_between(ends, heights, low - room, color=GROUND, linewidth=0)
    axis.plot(ends, heights, color=INK, linewidth=1.2)
    axis.set_ylim(low - room, high + 2.2 * room)
    for segment, start, left, right in zip(result.segments, ends, heights, heights[1:], strict=False):
        middle = start + 0.5 * segment.length
        text = segment.surface if segment.direction else ""
        axis.annotate(
            text,
            (middle, 0.5 * (left + right)),
            xytext=(0, 9),
            textcoords="offset points",
            ha="center",
            fontsize=7.5,
            color=INK,
        )
    _shade(axis, result)
    _label_axis(axis, "", "m", "")
    axis.grid(visible=False)


def _shade(axis: Axes, result: Result) -> None:
    """Shades the segments that go up and down."""
    start = 0.0
    for segment in result.segments:
        if segment.direction:
            axis.axvspan(start, start + segment.length, color=SHADES[segment.direction], linewidth=0, zorder=0)
        start += segment.length


def _colour(i: int) -> str:
    return COLOURS[i % len(COLOURS)]


def _points(axis: Axes, i: int, x: Array, y: ArrayLike, bars: ArrayLike, label: str) -> None:
    """The i-th method's points with their bars, joined by lines."""
    axis.errorbar(
        x,
        y,
        bars,
        label=label,
        color=_colour(i),
        marker=MARKERS[i % len(MARKERS)],
        markersize=5.0,
        linewidth=1.4,
        elinewidth=1.0,
        capsize=2.5,
    )


def _label(result: Result) -> str:
    return f"{result.name} (partial)" if result.partial else result.name


def _aside(x: Sequence[float], i: int, count: int, step: float) -> Array:
    """Places of the i-th of `count` methods, a little beside those of the others."""
    return np.array(x) + step * (i - 0.5 * (count - 1))


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _percent(rates: Sequence[Proportion]) -> tuple[Array, Array]:
    """Shares [n] and the lengths of their bars down and up [2, n], in percent."""
    share = np.array([rate.share for rate in rates])
    bars = np.array([share - [rate.low for rate in rates], [rate.high for rate in rates] - share])
    return 100.0 * share, 100.0 * np.maximum(bars, 0.0)


def _label_axis(axis: Axes, x: str, y: str, title: str) -> None:
    axis.set_title(title, fontsize=9.5, color=INK, loc="left")
    axis.set_xlabel(x, fontsize=9, color=INK)
    axis.set_ylabel(y, fontsize=9, color=INK)
    dress(axis)


def _legend(figure: Figure, axis: Axes) -> None:
    handles, labels = axis.get_legend_handles_labels()
    columns = max(1, min(len(labels), int(figure.get_figwidth() / 3.1)))
    figure.legend(
        handles, labels, loc="outside lower center", ncols=columns, fontsize=8.5, frameon=False, labelcolor=INK
    )


def _write(draw: Callable[[Figure], None], path: Path) -> Path:
    figure = new_figure()
    draw(figure)
    save_figure(figure, path, dpi=150)
    return path
