"""Comparison of training runs after the same number of environment steps."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from statistics import fmean

import numpy as np

from humoslope.errors import UserError
from humoslope.evaluation.report.curve import STEPS, Curve, read_curves
from humoslope.evaluation.report.seeds import ENOUGH_FOR_IQM, Estimate, Scores, Trials
from humoslope.evaluation.report.table import Column, Row, Sheet
from humoslope.slope.swing import SwingCalibration

WINDOW = 0.1
"""Share of the steps before the comparison over which a figure is averaged."""

MEASURES = {
    "Train/reward": Column("reward", "per s"),
    "Train/falls_per_second": Column("falls", "per s", 3),
    "Train/speed": Column("speed", "m/s", 3),
    "Curriculum/harness": Column("harness", digits=3),
    "Curriculum/terrain_levels": Column("level"),
}


CALIBRATED = tuple(f".params.{field.name.replace('_', '-')}" for field in fields(SwingCalibration))
"""Ends of options that a swing calibration sets, differently for every seed."""
SEED = "--env.seed"


@dataclass(frozen=True)
class TrainingRun:
    """A run that is compared.

    Attributes:
        folder: Run folder.
        task: Name of its task; "" if the folder does not say.
        options: Options by name, such as "--env.seed": "--env.seed 2".
    """

    folder: Path
    task: str
    options: Mapping[str, str]

    @property
    def row(self) -> str:
        """Row of a campaign that it belongs to, by its folder ROW/seedN; "" for none."""
        where = self.folder.resolve()
        return where.parent.name if re.fullmatch(r"seed\d+", where.name) else ""

    @property
    def name(self) -> str:
        """Name in tables."""
        return f"{self.row}/{self.folder.resolve().name}" if self.row else self.folder.resolve().name

    @property
    def method(self) -> tuple[object, ...]:
        """What runs have in common that differ in their seed alone."""
        own = (text for name, text in self.options.items() if name != SEED and not name.endswith(CALIBRATED))
        return (self.row, self.task, *sorted(own))


Curves = Mapping[str, Curve]


def compare(runs: Sequence[TrainingRun], at: float = 0.0, each: bool = False) -> list[Sheet]:
    """Tables of runs, each averaged over the last tenth of the steps before `at`.

    Runs that differ in their seed alone are one row, with an interval over seeds, and a second table has the
    differences from the first row. Without such runs there is one table with a row for each run.

    Args:
        at: Environment steps; 0 for those of the shortest run.
        each: A row for each run in any case.

    Raises:
        UserError: If a run has no curves, or is shorter than `at`.
    """
    curves, at = read_all(runs, at)
    shown = {tag: column for tag, column in MEASURES.items() if any(tag in of_run for of_run in curves)}
    title = f"After {at / 1e6:.2f} million environment steps"
    groups = grouped(runs)
    if each or len(groups) == len(runs):
        rows = tuple(
            Row(run.name, _note(run, runs), tuple(mean_before(of_run, tag, at) for tag in shown))
            for run, of_run in zip(runs, curves, strict=True)
        )
        note = f"Means over the last {WINDOW:.0%} of these steps; one run each says nothing about small differences."
        return [Sheet(title=title, columns=tuple(shown.values()), rows=rows, notes=(note,))]
    return _over_seeds(title, runs, curves, groups, shown, at)


def read_all(runs: Sequence[TrainingRun], at: float = 0.0) -> tuple[list[Curves], float]:
    """Curves of all runs, and the environment steps at which they can be compared; arguments as of `compare`."""
    curves: list[Curves] = [read_curves(run.folder) for run in runs]
    for run, of_run in zip(runs, curves, strict=True):
        if STEPS not in of_run:
            raise UserError(f"the curves of run '{run.folder}' hold no {STEPS}.")
    ends = [max(of_run[STEPS].values()) for of_run in curves]
    at = at or min(ends)
    for run, end in zip(runs, ends, strict=True):
        if end < at:
            raise UserError(
                f"run '{run.folder}' has {end:,.0f} environment steps; runs cannot be compared at {at:,.0f}."
            )
    return curves, at


def grouped(runs: Sequence[TrainingRun]) -> dict[str, list[int]]:
    """Places of runs that differ in their seed alone, by a name for them."""
    methods: dict[tuple[object, ...], list[int]] = {}
    for i, run in enumerate(runs):
        methods.setdefault(run.method, []).append(i)
    groups: dict[str, list[int]] = {}
    for places in methods.values():
        row = runs[places[0]].row
        name = row if row and len(places) > 1 else ", ".join(runs[i].name for i in places)
        groups[name if name not in groups else f"{name} ({len(groups) + 1})"] = places
    return groups


def _over_seeds(
    title: str,
    runs: Sequence[TrainingRun],
    curves: Sequence[Curves],
    groups: Mapping[str, Sequence[int]],
    shown: Mapping[str, Column],
    at: float,
) -> list[Sheet]:
    rows, differing = [], []
    first = next(iter(groups))
    scores = {
        name: {tag: _scores(f"{name} {tag}", [mean_before(curves[i], tag, at) for i in places]) for tag in shown}
        for name, places in groups.items()
    }
    for name, places in groups.items():
        note = " ".join(filter(None, (f"{len(places)} seed{'s' * (len(places) > 1)}", _note(runs[places[0]], runs))))
        of_group = scores[name].values()
        rows.append(Row(name, note, tuple(None if found is None else found.estimate() for found in of_group)))
        if len(places) >= ENOUGH_FOR_IQM:
            middle = tuple(None if found is None else found.interquartile_mean() for found in of_group)
            rows.append(Row(f"{name}, IQM", "interquartile mean of the seeds", middle))
        if name == first:
            continue
        found = [
            None if mine is None or theirs is None else mine.minus(theirs)
            for mine, theirs in zip(of_group, scores[first].values(), strict=True)
        ]
        differing.append(Row(name, note, tuple(found)))
        differing.append(Row(name, note, tuple(map(_verdict, found)), more=True))
    columns = [replace(column, interval=True) for column in shown.values()]
    notes = (
        f"Of each seed the mean over the last {WINDOW:.0%} of these steps. Intervals: 95 %, by a bootstrap over seeds, "
        "widened for few seeds by Student's t; a single seed has none.",
    )
    sheets = [Sheet(title=title, columns=tuple(columns), rows=tuple(rows), notes=notes)]
    if differing:
        signed = tuple(replace(column, signed=True) for column in columns)
        said = ("Higher or lower is said only where the interval of the difference is on one side of zero.",)
        sheets.append(Sheet(title=f"Differences from {first}", columns=signed, rows=tuple(differing), notes=said))
    return sheets


def _scores(name: str, of_seeds: Sequence[float | None]) -> Scores | None:
    values = [value for value in of_seeds if value is not None]
    return Scores([Trials(np.array([value]), np.ones(1)) for value in values], name) if values else None


def _verdict(difference: Estimate | None) -> str | None:
    if difference is None or difference.seeds == 1:
        return None if difference is None else "one seed"
    return ("higher" if difference.value > 0.0 else "lower") if difference.separate else "not separable"


def _note(run: TrainingRun, runs: Sequence[TrainingRun]) -> str:
    """Options of a run that the others do not all share. Between seeds of a method the seed goes without saying."""
    common = set.intersection(*({*other.options.values()} for other in runs))
    several = len(grouped(runs)) < len(runs)
    own = {name: text for name, text in run.options.items() if text not in common}
    if several:
        own = {name: text for name, text in own.items() if name != SEED and not name.endswith(CALIBRATED)}
    return shortened([*own.values()])


def shortened(options: Sequence[str], most: int = 2) -> str:
    """The first options, and the number of the others."""
    return " ".join([*options[:most], f"and {len(options) - most} more"] if len(options) > most else options)


def mean_before(curves: Mapping[str, Curve], tag: str, at: float) -> float | None:
    """Mean of a curve over the iterations that end in the last `WINDOW` of `at` steps; None if there are none."""
    there = [value for i, value in curves.get(tag, {}).items() if (1.0 - WINDOW) * at < curves[STEPS].get(i, 0.0) <= at]
    return fmean(there) if there else None
