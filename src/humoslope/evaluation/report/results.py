"""The results of an evaluation on a track: told for a JSON file, and read back for tables and figures."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from humoslope.errors import UserError
from humoslope.evaluation.track.metrics import BIN
from humoslope.evaluation.track.summary import Choice, Diagnosis, Outcomes, Summary, diagnose, profile, summarise
from humoslope.provenance import plain
from humoslope.statistics import Average, Proportion
from humoslope.terrain.course import Segment

HELD_OUT, SWEEP = "held-out", "sweep"
"""What a file may hold."""


@dataclass(frozen=True)
class Cell:
    """Trials of one grade and one friction tier.

    Attributes:
        grade: Nominal, degrees.
        tier: What the friction coefficient is above tan(grade).
    """

    grade: float
    tier: float
    summary: Summary


@dataclass(frozen=True)
class Grade:
    """Trials of one grade, all friction tiers together.

    Attributes:
        grade: Nominal, degrees.
        diagnosis: "up", "flat" and "down"; None where nobody was.
        profile: Values along the track by name, one for each bin of place; None where nobody was.
        reached: How many trials came at least to each multiple of the bin, from 0 on.
    """

    grade: float
    summary: Summary
    diagnosis: dict[str, Diagnosis | None]
    profile: dict[str, list[float | None]]
    reached: list[int]


@dataclass(frozen=True)
class Training:
    """What a checkpoint has behind it, with all that it started from.

    Attributes:
        steps: Environment steps of each stage, the first one first.
        harness: Scale that the training harness still had at the end of the last stage, zero if only earlier
            stages had one; None if no stage had one.
    """

    steps: tuple[int, ...]
    harness: float | None


@dataclass(frozen=True)
class Result:
    """One method's results.

    Attributes:
        name: What tables and figures call it.
        task: What was trained.
        training: Of each checkpoint whose trials are in it.
        finished, trials: Trials that are done, and that there should be.
        goal: Place at which a trial succeeds, m.
        segments: Of the track.
        grades: In rising order.
        cells: By grade and tier; those of a sweep only where there are no trials on the track.
        limit: Steepest grade of the slope-limit sweep, degrees; None if there was no sweep, or no grade was mastered.
        swept: Whether there was a sweep.
        beyond: Whether the limit may lie higher than the sweep went.
    """

    name: str
    task: str
    training: tuple[Training, ...]
    finished: int = 0
    trials: int = 0
    goal: float = 0.0
    segments: tuple[Segment, ...] = ()
    grades: tuple[Grade, ...] = ()
    cells: tuple[Cell, ...] = ()
    limit: float | None = None
    swept: bool = False
    beyond: bool = False

    @property
    def partial(self) -> bool:
        """Whether trials are missing."""
        return self.finished < self.trials

    def at(self, grade: float) -> Grade | None:
        """The results at a grade, if it was walked."""
        return next((g for g in self.grades if g.grade == grade), None)


def tell(
    outcomes: Outcomes,
    *,
    grades: Sequence[float],
    tiers: Sequence[float],
    segments: Sequence[Segment],
    speed: float,
    mass: float,
) -> dict[str, Any]:
    """What tables and figures need of finished trials, as JSON types. Conditions without a trial are left out.

    Args:
        grades, tiers: What `grade_index` and `tier_index` count, in degrees and in friction above tan(grade).
        segments: Of the track.
        speed: Commanded, m/s.
        mass: Of the robot, kg.
    """
    length = sum(segment.length for segment in segments)
    directions = [segment.direction for segment in segments]

    def figures(which: Choice) -> Summary:
        return summarise(outcomes, which, mass, speed)

    by_grade, by_cell = [], []
    for g, grade in enumerate(grades):
        there = outcomes.grade_index == g
        if not there.any():
            continue
        walked = outcomes.metrics[there]
        by_grade.append(
            Grade(
                grade, figures(there), diagnose(walked, directions), profile(walked), _reached(outcomes, there, length)
            )
        )
        for t, tier in enumerate(tiers):
            cell = there & (outcomes.tier_index == t)
            if cell.any():
                by_cell.append(Cell(grade, tier, figures(cell)))
    told: dict[str, Any] = plain(
        {"robot_mass": mass, "segments": list(segments), "grades": by_grade, "cells": by_cell},
    )
    for cell in told["cells"]:
        cell["friction"] = math.tan(math.radians(cell["grade"])) + cell["tier"]
    return told


def _reached(outcomes: Outcomes, which: NDArray[np.bool_], length: float) -> list[int]:
    edges = np.arange(math.floor(length / BIN + 1e-9) + 1) * BIN
    # A goal that was reached is reached, whatever single precision made of the place.
    return [int(n) for n in (outcomes.max_place[which][:, None] >= edges - 1e-4).sum(axis=0)]


def read_results(sources: Sequence[str]) -> list[Result]:
    """Results out of files, one for each method; a method's sweep joins its trials on the track.

    Args:
        sources: Files, NAME=FILE, or folders of files. Without a name a method is called by its task.

    Raises:
        UserError: If there is none, or one cannot be read, or two are of the same method.
    """
    files = [part for source in sources for part in _files(source)]
    results: dict[str, Result] = {}
    for name, path in files:
        new = _read(name, path)
        old = results.get(new.name)
        if old is None:
            results[new.name] = new
        elif old.swept == new.swept:
            raise UserError(f"'{path}' is the second result of '{new.name}'; tell them apart as NAME=FILE.")
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
        report = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UserError(f"result '{path}' does not exist.") from None
    except (OSError, UnicodeDecodeError, json.JSONDecodeError):
        raise UserError(f"'{path}' is no JSON file that can be read.") from None
    try:
        return read_report(report, name)
    except (KeyError, TypeError, IndexError):
        raise UserError(f"'{path}' is no result of `humoslope evaluate`, or one of another version.") from None


def read_report(report: Mapping[str, Any], name: str = "") -> Result:
    """The result that `humoslope evaluate` has told; without a name it is called by its task.

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
        limit = report["slope_limit"] or {"grade": None, "beyond": False}  # of a partial sweep there is none yet
        return replace(result, swept=True, limit=limit["grade"], beyond=limit["beyond"])
    if report["what"] != HELD_OUT:
        raise KeyError("what")
    return replace(
        result,
        goal=report["protocol"]["success_place"],
        segments=tuple(Segment(**s) for s in report["segments"]),
        grades=tuple(sorted((_grade(g) for g in report["grades"]), key=lambda g: g.grade)),
    )


def _training(checkpoint: Mapping[str, Any]) -> Training:
    ancestor = checkpoint.get("parent", checkpoint.get("ancestor"))  # its name in older results
    before = _training(ancestor) if ancestor else Training((), None)
    harness = checkpoint["harness"]
    if harness is None and before.harness is not None:
        harness = 0.0
    return Training((*before.steps, checkpoint["total_steps"]), harness)


def _grade(told: Mapping[str, Any]) -> Grade:
    diagnosis = {name: None if d is None else Diagnosis(**d) for name, d in told["diagnosis"].items()}
    return Grade(told["grade"], _summary(told["summary"]), diagnosis, told["profile"], told["reached"])


def _summary(told: Mapping[str, Any]) -> Summary:
    averages = {name: Average(**value) for name, value in told.items() if isinstance(value, dict) and "mean" in value}
    return Summary(**{**told, **averages, "success": Proportion(**told["success"])})
