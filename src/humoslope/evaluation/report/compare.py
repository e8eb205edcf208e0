"""Comparison of training runs after the same number of environment steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean

from humoslope.errors import UserError
from humoslope.evaluation.report.curve import STEPS, Curve, read_curves
from humoslope.evaluation.report.table import Column, Row, Sheet

WINDOW = 0.1
"""Share of the steps before the comparison over which a figure is averaged."""

MEASURES = {
    "Train/reward": Column("reward", "per s"),
    "Train/falls_per_second": Column("falls", "per s", 3),
    "Train/speed": Column("speed", "m/s", 3),
    "Curriculum/harness": Column("harness", digits=3),
    "Curriculum/terrain_levels": Column("level"),
}


def compare(runs: Sequence[Path], options: Sequence[Sequence[str]], at: float = 0.0) -> Sheet:
    """Table of runs, each averaged over the last tenth of the steps before `at`.

    Args:
        runs: Run folders.
        options: Options of each run, such as "--env.seed 2". Options that the runs do not all share are shown beside a
            run's name.
        at: Environment steps; 0 for those of the shortest run.

    Raises:
        UserError: If a run has no curves, or is shorter than `at`.
    """
    curves = [read_curves(run) for run in runs]
    for run, of_run in zip(runs, curves, strict=True):
        if STEPS not in of_run:
            raise UserError(f"the curves of run '{run}' hold no {STEPS}.")
    ends = [max(of_run[STEPS].values()) for of_run in curves]
    at = at or min(ends)
    for run, end in zip(runs, ends, strict=True):
        if end < at:
            raise UserError(f"run '{run}' has {end:,.0f} environment steps; runs cannot be compared at {at:,.0f}.")
    shown = {tag: column for tag, column in MEASURES.items() if any(tag in of_run for of_run in curves)}
    common = set.intersection(*(set(words) for words in options))
    return Sheet(
        title=f"After {at / 1e6:.2f} million environment steps",
        columns=tuple(shown.values()),
        rows=tuple(
            Row(
                name=run.resolve().name,
                note=shortened([words for words in of_options if words not in common]),
                values=tuple(mean_before(of_run, tag, at) for tag in shown),
            )
            for run, of_run, of_options in zip(runs, curves, options, strict=True)
        ),
        notes=(f"Means over the last {WINDOW:.0%} of these steps; one run each says nothing about small differences.",),
    )


def shortened(options: Sequence[str], most: int = 2) -> str:
    """The first options, and the number of the others."""
    return " ".join([*options[:most], f"and {len(options) - most} more"] if len(options) > most else options)


def mean_before(curves: Mapping[str, Curve], tag: str, at: float) -> float | None:
    """Mean of a curve over the iterations that end in the last `WINDOW` of `at` steps; None if there are none."""
    there = [value for i, value in curves.get(tag, {}).items() if (1.0 - WINDOW) * at < curves[STEPS].get(i, 0.0) <= at]
    return fmean(there) if there else None
