"""Results of an evaluation on a track: written as JSON, and read back for tables and figures."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from humoslope.errors import UserError
from humoslope.evaluation.causes import count
from humoslope.evaluation.track.metrics import BIN, Figure
from humoslope.evaluation.track.protocol import HeldOutProtocol, departing
from humoslope.evaluation.track.summary import (
    Diagnosis,
    Outcomes,
    Summary,
    diagnose,
    profile,
    summarise,
    trial_values,
)
from humoslope.provenance import plain
from humoslope.seal import read_json
from humoslope.statistics import Array, Average, Bools, Proportion
from humoslope.terrain.course import Segment

HELD_OUT, SWEEP = "held-out", "sweep"
"""Kinds of result files."""
CAMPAIGN = "campaign.toml"
"""Copy of its file that a campaign leaves in its folder."""


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
        trials: Values of single trials by the names of `EACH`, as numbers in a text; results of older versions have
            none.
    """

    grade: float
    summary: Summary
    diagnosis: dict[str, Diagnosis | None]
    profile: dict[str, list[float | None]]
    reached: list[int]
    causes: dict[str, int] | None = None
    trials: dict[str, str] = field(default_factory=dict)

    def each(self, name: str) -> Array | None:
        """Values [T] of single trials, NaN where nothing was measured; None if the result does not hold them."""
        return np.array(self.trials[name].split(), dtype=np.float64) if name in self.trials else None


@dataclass(frozen=True)
class Training:
    """Training of a checkpoint and of all that it started from.

    Attributes:
        steps: Environment steps of each stage, the first one first; none for a policy from outside.
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
        checkpoints: SHA-256 of the checkpoints whose trials are pooled here, as far as the result says.
        variant: What sets the trained network apart from others of its task, such as a reduced voxel grid; the name
            ends with it.
        departures: Settings that differ from the protocol's, in words; "" for none.
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
    checkpoints: tuple[str, ...] = ()
    variant: str = ""
    departures: str = ""

    @property
    def given_name(self) -> str:
        """The name without the variant."""
        return self.name.removesuffix(f", {self.variant}")

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
                trials=_texts(trial_values(outcomes, there, mass, speed)),
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


def _texts(values: Mapping[str, Array]) -> dict[str, str]:
    """Numbers to six digits; in lists each would have a line of its own in the file."""
    return {name: " ".join(f"{value:.6g}" for value in of_trials) for name, of_trials in values.items()}


def _reached(outcomes: Outcomes, which: Bools, length: float) -> list[int]:
    edges = np.arange(math.floor(length / BIN + 1e-9) + 1) * BIN
    # Places are in single precision: a goal that was reached must not be missed by rounding.
    return [int(n) for n in (outcomes.max_place[which][:, None] >= edges - 1e-4).sum(axis=0)]


@dataclass(frozen=True)
class Method:
    """Results of one method from one or more trainings, which differ by their seed.

    Attributes:
        name: Name in tables.
        runs: Result of each training.
    """

    name: str
    runs: tuple[Result, ...]

    @property
    def partial(self) -> bool:
        """True if trials of a training are missing."""
        return any(run.partial for run in self.runs)


def read_results(sources: Sequence[str]) -> list[Result]:
    """Results from files, one for each method; a method's sweep joins its trials on the track.

    Args:
        sources: Files, NAME=FILE, folders of files, or folders of campaigns. Without a name a method is called by its
            task.

    Raises:
        UserError: If there are no results, one cannot be read, two are of the same method, or a sweep is of another
            checkpoint.
    """
    methods = _read_all(sources)
    for found in methods.values():
        kinds = [result.swept for _, result in found]
        for i, (path, result) in enumerate(found):
            if result.swept in kinds[:i]:
                raise _second(path, result)
    return [_joined(found) for found in methods.values()]


def read_methods(sources: Sequence[str]) -> list[Method]:
    """Results from files as `read_results` reads them, but with several results of one method from different trainings.

    Raises:
        UserError: If there are no results, one cannot be read, two are of the same training, or the sweep of the only
            training is of another checkpoint.
    """
    methods = []
    for name, found in _read_all(sources).items():
        if len(found) == 2 and found[0][1].swept != found[1][1].swept:
            methods.append(Method(name, (_joined(found),)))
            continue
        trainings: dict[tuple[str, ...], list[tuple[Path, Result]]] = {}
        for path, result in found:
            of_training = trainings.setdefault(result.checkpoints, [])
            if any(other.swept == result.swept for _, other in of_training):
                raise _second(path, result)
            of_training.append((path, result))
        methods.append(Method(name, tuple(_joined(of_training) for of_training in trainings.values())))
    return methods


def _read_all(sources: Sequence[str]) -> dict[str, list[tuple[Path, Result]]]:
    """Files and results by the name of the method, in the order in which they were given."""
    methods: dict[str, list[tuple[Path, Result]]] = {}
    for name, path in [part for source in sources for part in _files(source)]:
        result = _read(name, path)
        methods.setdefault(result.name, []).append((path, result))
    if not methods:
        raise UserError(f"there are no results in {', '.join(sources) or 'nothing'}; `humoslope evaluate` makes them.")
    return methods


def _joined(found: Sequence[tuple[Path, Result]]) -> Result:
    """A result on the track with its sweep, if there are both."""
    if len(found) == 1:
        return found[0][1]
    (path, track), (of_sweep, sweep) = sorted(found, key=lambda part: part[1].swept)
    hashes = [sorted(result.checkpoints) for result in (track, sweep)]
    if all(hashes) and hashes[0] != hashes[1]:
        raise UserError(
            f"'{path}' and '{of_sweep}' are both of '{track.name}', but of different checkpoints; "
            "name them as NAME=FILE."
        )
    return with_sweep(track, sweep)


def with_sweep(track: Result, sweep: Result) -> Result:
    """Trials on the track with the limit of a sweep."""
    of_sweep = f"in the sweep {sweep.departures}" if sweep.departures not in ("", track.departures) else ""
    return replace(
        track,
        limit=sweep.limit,
        swept=True,
        beyond=sweep.beyond,
        departures=", ".join(filter(None, (track.departures, of_sweep))),
    )


def _second(path: Path, result: Result) -> UserError:
    return UserError(f"'{path}' is the second result of '{result.name}'; name them as NAME=FILE.")


def _files(source: str) -> list[tuple[str, Path]]:
    name, equals, path = source.partition("=")
    if not equals or Path(source).exists():
        name, path = "", source
    where = Path(path)
    if not where.is_dir():
        return [(name, where)]
    here = [(name, file) for file in sorted(where.glob("*.json"))]
    return here or [(name or own, file) for own, file in _campaign_files(where)]


def _campaign_files(folder: Path) -> list[tuple[str, Path]]:
    """Results in the run folders of a campaign, FOLDER/ROW/seedN.

    Rows are called by their tasks if these are different, else by their own names.
    """
    found: list[Path] = []
    tasks: dict[str, str] = {}
    for path in folder.glob("*/seed*/*.json"):
        try:
            report = read_json(path)
            if report["what"] in (HELD_OUT, SWEEP):
                tasks[path.parent.parent.name] = report["checkpoints"][0]["task"]
                found.append(path)
        except (OSError, ValueError, KeyError, TypeError, IndexError):
            continue  # a calibration, or a file that the campaign makes anew
    by_task = len(set(tasks.values())) == len(tasks)
    ordered = by_row(folder, found, lambda path: path.parent)
    return [("" if by_task else path.parent.parent.name, path) for path in ordered]


def by_row(folder: Path, paths: Sequence[Path], run_folder: Callable[[Path], Path]) -> list[Path]:
    """Files of a campaign's folder in the order of the rows in its file, and of the seeds.

    Args:
        run_folder: The run folder of each, ROW/seedN.
    """
    try:
        order = list(tomllib.loads((folder / CAMPAIGN).read_text(encoding="utf-8"))["train"])
    except (OSError, ValueError, KeyError, TypeError):
        order = []

    def place(path: Path) -> tuple[int, str, int, str, str]:
        row, seed = run_folder(path).parent.name, run_folder(path).name
        return order.index(row) if row in order else len(order), row, len(seed), seed, path.name

    return sorted(paths, key=place)


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
        name: Name of the method; by default its task. A variant is named in any case.

    Raises:
        KeyError, TypeError, IndexError: If it is something else.
    """
    checkpoints = report["checkpoints"]
    task, variant = checkpoints[0]["task"], checkpoints[0].get("variant", "")
    called = name or task
    protocol = report["protocol"]
    result = Result(
        name=f"{called}, {variant}" if variant else called,
        task=task,
        variant=variant,
        training=tuple(_training(c) for c in checkpoints),
        finished=report["finished"],
        trials=report["trials"],
        cells=tuple(Cell(c["grade"], c["tier"], _summary(c["summary"])) for c in report["cells"]),
        checkpoints=tuple(c["sha256"] for c in checkpoints if "sha256" in c),
        departures=departing(protocol, HeldOutProtocol()),
    )
    if report["what"] == SWEEP:
        limit = report["slope_limit"] or {"grade": None, "beyond": False}  # a partial sweep has none yet
        return replace(result, swept=True, limit=limit["grade"], beyond=limit["beyond"])
    if report["what"] != HELD_OUT:
        raise KeyError("what")
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
    steps = checkpoint["total_steps"]  # null for a policy from outside
    return Training(before.steps if steps is None else (*before.steps, steps), harness)


def _grade(report: Mapping[str, Any]) -> Grade:
    diagnosis = {name: None if d is None else Diagnosis(**d) for name, d in report["diagnosis"].items()}
    summary, trials, causes = _summary(report["summary"]), report.get("trials", {}), report.get("causes")
    grade = Grade(report["grade"], summary, diagnosis, report["profile"], report["reached"], causes, trials)
    totals = {figure.total for figure in summary.values() if isinstance(figure, Proportion)}
    if not all(len(grade.each(name)) in totals for name in trials):  # type: ignore[arg-type]
        raise ValueError("trials")
    return grade


def _summary(report: Mapping[str, Any]) -> Summary:
    """Figures by name. A proportion has a count, an average a mean, and everything else is a number or None."""

    def figure(value: Any) -> Figure:
        if isinstance(value, Mapping):
            return Proportion(**value) if "count" in value else Average(**value)
        if value is not None and not isinstance(value, int | float):
            raise TypeError(value)
        return value

    return {name: figure(value) for name, value in report.items()}
