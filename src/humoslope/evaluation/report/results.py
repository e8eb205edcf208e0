"""Results of an evaluation on a track: written as JSON, and read back for tables and figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from humoslope.errors import UserError
from humoslope.evaluation.causes import count
from humoslope.evaluation.track.metrics import BIN, Figure
from humoslope.evaluation.track.summary import Diagnosis, Outcomes, Summary, diagnose, profile, summarise
from humoslope.provenance import plain
from humoslope.seal import read_json
from humoslope.statistics import Average, Bools, Proportion
from humoslope.terrain.course import Segment

HELD_OUT, SWEEP = "held-out", "sweep"
"""Kinds of result files."""


@dataclass(frozen=True)
class Cell:
    """Trials of one grade and one friction tier.

    Attributes:
        grade: Nominal grade, degrees.
        tier: Friction coefficient less tan(grade).
        summary: Figures of the trials.
    """

    grade: float
    tier: float
    summary: Summary


@dataclass(frozen=True)
class Grade:
    """Trials of one grade, all friction tiers together.

    Attributes:
        grade: Nominal grade, degrees.
        summary: Figures of the trials.
        diagnosis: Posture and load by "up", "flat" and "down"; None where no trial came.
        profile: Values along the track by name, one for each bin of place; None where no trial came.
        reached: Number of trials that came at least to each multiple of the bin, from 0 on.
        causes: Number of failed trials by their first cause; None in results of before causes were named.
    """

    grade: float
    summary: Summary
    diagnosis: dict[str, Diagnosis | None]
    profile: dict[str, list[float | None]]
    reached: list[int]
    causes: dict[str, int] | None = None


@dataclass(frozen=True)
class Training:
    """Training of a checkpoint and of all that it started from.

    Attributes:
        steps: Environment steps of each stage, the first one first.
        harness: Scale of the training harness at the end of the last stage, zero if only earlier stages had one; None
            if no stage had one.
    """

    steps: tuple[int, ...]
    harness: float | None


@dataclass(frozen=True)
class TrialSetup:
    """Assignment of the trials on a track.

    Attributes:
        speed: Commanded forward speed along the ground, m/s.
        start: Mean place of the start, m.
        goal: Place at which a trial succeeds, m.
        segments: Segments of the track.
    """

    speed: float
    start: float
    goal: float
    segments: tuple[Segment, ...]

    def commanded_seconds(self, grade: float) -> float:
        """Time from start to goal at exactly the commanded speed, s.

        Speed is commanded along the ground, so that slopes take longer than their horizontal length says.

        Args:
            grade: Nominal grade, degrees.
        """
        ground, begin = 0.0, 0.0
        for segment in self.segments:
            end = begin + segment.length
            level = max(0.0, min(end, self.goal) - max(begin, self.start))
            ground += level / math.cos(math.radians(grade)) if segment.direction else level
            begin = end
        return ground / self.speed


@dataclass(frozen=True)
class Result:
    """Results of one method.

    Attributes:
        name: Name in tables and figures.
        task: Task that was trained.
        training: Training of each checkpoint whose trials are pooled here.
        finished, trials: Trials that are done, and trials in all.
        setup: Assignment of the trials on the track; None for a sweep alone.
        grades: Results by grade, in rising order.
        cells: Results by grade and tier; those of a sweep only if there are no trials on the track.
        limit: Steepest grade of the slope-limit sweep, degrees; None if there was no sweep, or no grade was mastered.
        swept: True if there was a sweep.
        beyond: True if the limit may lie above the steepest grade of the sweep.
    """

    name: str
    task: str
    training: tuple[Training, ...]
    finished: int = 0
    trials: int = 0
    setup: TrialSetup | None = None
    grades: tuple[Grade, ...] = ()
    cells: tuple[Cell, ...] = ()
    limit: float | None = None
    swept: bool = False
    beyond: bool = False

    @property
    def goal(self) -> float:
        """Place at which a trial succeeds, m."""
        return self.setup.goal if self.setup else 0.0

    @property
    def segments(self) -> tuple[Segment, ...]:
        """Segments of the track."""
        return self.setup.segments if self.setup else ()

    @property
    def partial(self) -> bool:
        """True if trials are missing."""
        return self.finished < self.trials

    def at(self, grade: float) -> Grade | None:
        """Results at a grade; None if there are none."""
        return next((g for g in self.grades if g.grade == grade), None)


def to_report(
    outcomes: Outcomes,
    *,
    grades: Sequence[float],
    tiers: Sequence[float],
    segments: Sequence[Segment],
    speed: float,
    mass: float,
    causes: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Finished trials as the JSON types that tables and figures are made from. Conditions without a trial are left out.

    Args:
        grades, tiers: Conditions that `grade_index` and `tier_index` refer to, in degrees and in friction above
            tan(grade).
        segments: Segments of the track.
        speed: Commanded speed, m/s.
        mass: Mass of the robot, kg.
        causes: First cause of each trial, "" for a success.
    """
    length = sum(segment.length for segment in segments)
    directions = [segment.direction for segment in segments]

    def figures(which: Bools) -> Summary:
        return summarise(outcomes, which, mass, speed)

    by_grade, by_cell = [], []
    for g, grade in enumerate(grades):
        there = outcomes.grade_index == g
        if not there.any():
            continue
        recorded = outcomes.metrics[there]
        by_grade.append(
            Grade(
                grade=grade,
                summary=figures(there),
                diagnosis=diagnose(recorded, directions),
                profile=profile(recorded),
                reached=_reached(outcomes, there, length),
                causes=None if causes is None else count([causes[i] for i in np.flatnonzero(there).tolist()]),
            )
        )
        for t, tier in enumerate(tiers):
            cell = there & (outcomes.tier_index == t)
            if cell.any():
                by_cell.append(Cell(grade, tier, figures(cell)))
    report: dict[str, Any] = plain(
        {"robot_mass": mass, "segments": list(segments), "grades": by_grade, "cells": by_cell},
    )
    for cell in report["cells"]:
        cell["friction"] = math.tan(math.radians(cell["grade"])) + cell["tier"]
    return report


def _reached(outcomes: Outcomes, which: Bools, length: float) -> list[int]:
    edges = np.arange(math.floor(length / BIN + 1e-9) + 1) * BIN
    # Places are in single precision: a goal that was reached must not be missed by rounding.
    return [int(n) for n in (outcomes.max_place[which][:, None] >= edges - 1e-4).sum(axis=0)]


def read_results(sources: Sequence[str]) -> list[Result]:
    """Results from files, one for each method; a method's sweep joins its trials on the track.

    Args:
        sources: Files, NAME=FILE, or folders of files. Without a name a method is called by its task.

    Raises:
        UserError: If there are no results, one cannot be read, or two are of the same method.
    """
    files = [part for source in sources for part in _files(source)]
    results: dict[str, Result] = {}
    for name, path in files:
        new = _read(name, path)
        old = results.get(new.name)
        if old is None:
            results[new.name] = new
        elif old.swept == new.swept:
            raise UserError(f"'{path}' is the second result of '{new.name}'; name them as NAME=FILE.")
        else:
            track, sweep = (old, new) if new.swept else (new, old)
            results[new.name] = replace(track, limit=sweep.limit, swept=True, beyond=sweep.beyond)
    if not results:
        raise UserError(f"there are no results in {', '.join(sources) or 'nothing'}; `humoslope evaluate` makes them.")
    return list(results.values())


def _files(source: str) -> list[tuple[str, Path]]:
    name, equals, path = source.partition("=")
    if not equals or Path(source).exists():
        name, path = "", source
    where = Path(path)
    return [(name, file) for file in sorted(where.glob("*.json"))] if where.is_dir() else [(name, where)]


def _read(name: str, path: Path) -> Result:
    try:
        report = read_json(path)
    except FileNotFoundError:
        raise UserError(f"result '{path}' does not exist.") from None
    except OSError as error:
        raise UserError(f"result '{path}' cannot be read: {error.strerror}.") from None
    except (ValueError, RecursionError) as error:
        fault = str(error) if "checksum" in str(error) else "it is not a readable JSON file"
        raise UserError(f"result '{path}' is damaged or was changed by hand: {fault}.") from None
    try:
        return _believable(from_report(report, name))
    except (KeyError, TypeError, IndexError, ValueError, AttributeError):
        raise UserError(f"'{path}' is not a result of `humoslope evaluate`, or of another version.") from None


def from_report(report: Mapping[str, Any], name: str = "") -> Result:
    """The result in a report of `humoslope evaluate`.

    Args:
        name: Name of the method; by default its task.

    Raises:
        KeyError, TypeError, IndexError: If it is something else.
    """
    checkpoints = report["checkpoints"]
    task = checkpoints[0]["task"]
    result = Result(
        name=name or task,
        task=task,
        training=tuple(_training(c) for c in checkpoints),
        finished=report["finished"],
        trials=report["trials"],
        cells=tuple(Cell(c["grade"], c["tier"], _summary(c["summary"])) for c in report["cells"]),
    )
    if report["what"] == SWEEP:
        limit = report["slope_limit"] or {"grade": None, "beyond": False}  # a partial sweep has none yet
        return replace(result, swept=True, limit=limit["grade"], beyond=limit["beyond"])
    if report["what"] != HELD_OUT:
        raise KeyError("what")
    protocol = report["protocol"]
    return replace(
        result,
        setup=TrialSetup(
            speed=protocol["speed"],
            start=protocol["start_place"],
            goal=protocol["success_place"],
            segments=tuple(Segment(**s) for s in report["segments"]),
        ),
        grades=tuple(sorted((_grade(g) for g in report["grades"]), key=lambda g: g.grade)),
    )


def _believable(result: Result) -> Result:
    """The result itself.

    Raises:
        ValueError: If a number in it is not finite, or a count is larger than what it is a part of.
    """
    if not isinstance(result.finished, int) or not isinstance(result.trials, int) or result.finished > result.trials:
        raise ValueError("finished")
    for grade in result.grades:
        counts = {} if grade.causes is None else grade.causes
        if not all(isinstance(n, int) and n >= 0 for n in counts.values()):
            raise ValueError("causes")
    for summary in [g.summary for g in result.grades] + [c.summary for c in result.cells]:
        for figure in summary.values():
            numbers = vars(figure).values() if isinstance(figure, Proportion | Average) else (figure,)
            if not all(v is None or (isinstance(v, int | float) and math.isfinite(v)) for v in numbers):
                raise ValueError("a figure")
            if isinstance(figure, Proportion) and not 0 <= figure.count <= figure.total != 0:
                raise ValueError("a proportion")
    return result


def _training(checkpoint: Mapping[str, Any]) -> Training:
    ancestor = checkpoint.get("parent", checkpoint.get("ancestor"))  # its name in older results
    before = _training(ancestor) if ancestor else Training((), None)
    harness = checkpoint["harness"]
    if harness is None and before.harness is not None:
        harness = 0.0
    return Training((*before.steps, checkpoint["total_steps"]), harness)


def _grade(report: Mapping[str, Any]) -> Grade:
    diagnosis = {name: None if d is None else Diagnosis(**d) for name, d in report["diagnosis"].items()}
    causes = report.get("causes")
    return Grade(report["grade"], _summary(report["summary"]), diagnosis, report["profile"], report["reached"], causes)


def _summary(report: Mapping[str, Any]) -> Summary:
    """Figures by name. A proportion has a count, an average a mean, and everything else is a number or None."""

    def figure(value: Any) -> Figure:
        if isinstance(value, Mapping):
            return Proportion(**value) if "count" in value else Average(**value)
        if value is not None and not isinstance(value, int | float):
            raise TypeError(value)
        return value

    return {name: figure(value) for name, value in report.items()}
