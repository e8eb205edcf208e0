"""The paper's tables with our figures, and the paper's below each of ours."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from humoslope.evaluation.causes import CAUSES, MEANING
from humoslope.evaluation.report.paper import Paper, PaperRow
from humoslope.evaluation.report.results import Grade, Result, Training, TrialSetup
from humoslope.evaluation.report.table import Column, Row, Sheet, Value
from humoslope.evaluation.track.metrics import GROUPS, REPORTED
from humoslope.evaluation.track.summary import DIRECTIONS, Summary
from humoslope.statistics import Proportion

GRADES = (0.0, 10.0, 20.0, 30.0)
"""Degrees; the paper's four nominal grades, shown if there are no results."""
PAPER_NOTE = "paper: as printed there, on another track in another simulator; its training budget is not stated."
SR_NOTE = "SR: share of trials that reach the goal, with Wilson's 95 % interval; all friction tiers together."
SELF_NOTE = "self-contact: share of the time in which two parts of the robot press on each other, mean over trials."
ABLATION_NOTES = (
    "CoT: sum of |torque x velocity| over weight and forward way, all trials. τ_knee: mean of trials' peaks.",
    "h_com: above the ground below the centre of mass. error: of a trial's mean speed from the commanded one.",
)
LIMIT_NOTE = "Max grade: steepest with SR of 50 % and more in the slope-limit sweep."
BEYOND = "the sweep ends there, the limit may be higher."
MEAN_NOTE = "±: 95 % of the mean over trials of this policy on this track, by Student's t."
AT_SPEED = "at the commanded speed"
"""Name of the row with the time that the commanded speed takes."""

TASK = ("success", "max_distance", "traversal_s")
"""Metrics of table 1, and the first ones of table 2."""
ABLATION = (*TASK, "cost_of_transport", "yaw_rate_variance", "com_height", "knee_peak")
"""Metrics of table 2 that the paper has."""
MORE = ("knee_p99", "speed", "speed_error")
"""Metrics that the paper does not have, beside them."""
LATER = ("self_contact",)
"""Metrics that older results lack; tables have columns of them only if a result has them."""


def _columns(names: Sequence[str], group: str = "") -> list[Column]:
    """A column for each metric of these names."""
    metrics = [REPORTED[name] for name in names]
    return [Column(m.label, m.unit, m.digits, group, m.interval) for m in metrics]


def _ours(summary: Summary | None, names: Sequence[str]) -> list[Value]:
    """Figures of these metrics; None where a result does not have one."""
    return [None if summary is None else summary.get(name) for name in names]


def their_figures(row: PaperRow, grade: float, names: Sequence[str]) -> list[Value]:
    """The paper's figures of these metrics at a grade."""
    figures = row.grades.get(grade, {})
    return [figures.get(REPORTED[name].paper) for name in names]


def _later(results: Sequence[Result]) -> list[str]:
    """Those of `LATER` that one of the results has."""
    measured = {name for result in results for cell in result.cells for name in cell.summary}
    return [name for name in LATER if name in measured]


def main_table(results: Sequence[Result], paper: Paper) -> Sheet:
    """Table 1: success rate, furthest distance and time at each grade, and the steepest grade."""
    grades = sorted({at.grade for result in results for at in result.grades}) or list(GRADES)
    names = (*TASK, *_later(results))

    def ours(result: Result) -> list[Value]:
        return [figure for grade in grades for figure in _ours(_summary(result.at(grade)), names)] + [result.limit]

    def theirs(row: PaperRow) -> list[Value]:
        return [figure for grade in grades for figure in their_figures(row, grade, names)] + [row.max_grade]

    notes = [
        SR_NOTE,
        MEAN_NOTE,
        *metric_notes(results, grades, names),
        LIMIT_NOTE,
        *(f"{r.name}: {BEYOND}" for r in results if r.beyond),
    ]
    columns = [column for grade in grades for column in _columns(names, f"{grade:g}°")]
    rows = _beside(results, paper.main, ours, theirs)
    return Sheet(
        title="Held-out slope tracks (paper, table 1)",
        columns=(*columns, Column("max grade", "°", 0)),
        rows=(*(_at_speed(setup, grades, names, after=1) for setup in _setups(results)), *rows),
        notes=(*notes, PAPER_NOTE, *partial_note(results)),
    )


def _setups(results: Sequence[Result]) -> list[TrialSetup]:
    """The different setups of the results, in their order."""
    return list(dict.fromkeys(result.setup for result in results if result.setup is not None))


def _at_speed(setup: TrialSetup, grades: Sequence[float], names: Sequence[str], after: int) -> Row:
    """Row with the time that the commanded speed takes.

    Args:
        names: Metrics of the columns at each grade.
        after: Columns after those.
    """
    figures = [setup.commanded_seconds(g) if name == "traversal_s" else None for g in grades for name in names]
    note = f"{setup.speed:g} m/s along the ground to {setup.goal:g} m"
    return Row(AT_SPEED, note, (*figures, *(None,) * after), source="reference")


def metric_notes(results: Sequence[Result], grades: Sequence[float], names: Sequence[str]) -> list[str]:
    """Remarks that tables of these metrics at these grades need, beyond those on their intervals."""
    return [
        *_time_notes(results, grades),
        *([SELF_NOTE] if "self_contact" in names else []),
        *(ABLATION_NOTES if set(ABLATION) <= set(names) else ()),
    ]


def _time_notes(results: Sequence[Result], grades: Sequence[float]) -> list[str]:
    """Remarks on T_trav and MXD, with the time at each grade that the commanded speed takes."""
    notes = ["T_trav: over successes. Less than the time at the commanded speed is over-speed, not precision."]
    for setup in _setups(results):
        times = ", ".join(f"{setup.commanded_seconds(grade):.1f} s at {grade:g}°" for grade in grades)
        notes.append(
            f"The commanded {setup.speed:g} m/s along the ground take {times}. A success ends a trial, so MXD stops at "
            f"{setup.goal:g} m here; some of the paper's go on to 32.2 m."
        )
    return notes


def ablation_table(results: Sequence[Result], paper: Paper, grade: float = 20.0) -> Sheet:
    """Table 2: task performance, efficiency, stability, posture and load at one grade, by default the paper's."""

    names = (*ABLATION, *MORE, *_later(results))

    def ours(result: Result) -> list[Value]:
        return _ours(_summary(result.at(grade)), names)

    def theirs(row: PaperRow) -> list[Value]:
        return their_figures(row, grade, names)

    return Sheet(
        title=f"Variants at {grade:g}° (paper, table 2)",
        columns=tuple(_columns(names)),
        rows=_beside(results, paper.ablation if grade == paper.ablation_grade else (), ours, theirs),
        notes=(
            SR_NOTE,
            MEAN_NOTE,
            *metric_notes(results, [grade], names),
            PAPER_NOTE,
            *partial_note(results),
        ),
    )


DIAGNOSTIC_COLUMNS = (
    Column("on"),
    Column("torso pitch", "°", 1),
    Column("knee flexion", "°", 1),
    *(Column(joint, "Nm", 1, group="torque") for joint in GROUPS),
    *(Column(joint, group=sign) for sign in ("work +", "work -") for joint in GROUPS),
)


def diagnostics_table(results: Sequence[Result], grade: float = 20.0) -> Sheet:
    """Posture and load uphill, on the flat and downhill, at one grade."""
    rows = []
    for result in results:
        there = result.at(grade)
        for i, direction in enumerate(DIRECTIONS):
            found = there.diagnosis[direction] if there else None
            values: tuple[Value, ...] = (direction, *(None for _ in DIAGNOSTIC_COLUMNS[1:]))
            if found is not None:
                nothing = dict.fromkeys(found.torque)
                values = (
                    direction,
                    math.degrees(found.torso_pitch),
                    math.degrees(found.knee_flexion),
                    *found.torque.values(),
                    *(found.positive_share or nothing).values(),
                    *(found.negative_share or nothing).values(),
                )
            rows.append(Row(result.name, note_of([result]), values, partial=_partial(result), more=i > 0))
    return Sheet(
        title=f"Posture and load by direction at {grade:g}°",
        columns=DIAGNOSTIC_COLUMNS,
        rows=tuple(rows),
        notes=(
            "Pitch joints of both legs, all friction tiers, all trials. torque: mean |torque| of one joint.",
            "work +, -: share of each in the positive and in the negative work of the three.",
            *partial_note(results),
        ),
    )


def causes_table(results: Sequence[Result]) -> Sheet:
    """The failed trials at each grade by the first thing that went wrong."""
    shown = [g.causes for result in results for g in result.grades if g.causes is not None]
    names = [name for name in CAUSES if any(name in causes for causes in shown)]
    rows = []
    for result in results:
        for i, at in enumerate(result.grades):
            rate = at.summary["success"]
            assert isinstance(rate, Proportion)
            counts = [None if at.causes is None else at.causes.get(name, 0) for name in names]
            values = (at.grade, rate.total, rate.total - rate.count, *counts)
            rows.append(Row(result.name, note_of([result]), values, partial=_partial(result), more=i > 0))
    return Sheet(
        title="Why trials failed: the first cause, by grade",
        columns=(
            Column("grade", "°", 0),
            Column("trials", digits=0),
            Column("failed", digits=0),
            *(Column(name, digits=0) for name in names),
        ),
        rows=tuple(rows),
        notes=(
            *(f"{name}: {MEANING[name]}." for name in names),
            *(["-: the trials were evaluated before causes were named."] if len(shown) < len(rows) else []),
            *partial_note(results),
        ),
    )


def cells_table(results: Sequence[Result]) -> Sheet:
    """Every reported metric at each grade and friction."""
    rows, absent = [], set(LATER) - set(_later(results))
    names = [name for name in REPORTED if name not in absent]
    for result in results:
        for i, cell in enumerate(result.cells):
            friction = math.tan(math.radians(cell.grade)) + cell.tier
            values = (cell.grade, friction, *_ours(cell.summary, names))
            rows.append(Row(result.name, note_of([result]), values, partial=_partial(result), more=i > 0))
    return Sheet(
        title="By grade and friction",
        columns=(Column("grade", "°", 0), Column("friction"), *_columns(names)),
        rows=tuple(rows),
        notes=(
            MEAN_NOTE,
            "CoT +: of positive work alone. τ_knee: mean of the trials' peaks.",
            *partial_note(results),
        ),
    )


def _summary(at: Grade | None) -> Summary | None:
    return None if at is None else at.summary


def _beside(
    results: Sequence[Result],
    printed: Sequence[PaperRow],
    ours: Callable[[Result], Sequence[Value]],
    theirs: Callable[[PaperRow], Sequence[Value]],
) -> tuple[Row, ...]:
    """Our rows with the corresponding ones of the paper below each, and then the other rows of the paper."""
    rows, left = [], list(printed)
    for result in results:
        rows.append(Row(result.name, note_of([result]), tuple(ours(result)), partial=_partial(result)))
        for row in printed:
            if row.matches(result):
                rows.append(Row(row.name, "", tuple(theirs(row)), source="paper"))
                left = [other for other in left if other is not row]
    return (*rows, *(Row(row.name, "", tuple(theirs(row)), source="paper") for row in left))


def note_of(results: Sequence[Result]) -> str:
    """What the figures of a row rest on: the training of these results, and where they depart from the protocol."""
    departures = ", ".join(dict.fromkeys(result.departures for result in results if result.departures))
    training = training_of([result.training for result in results])
    return f"{training}; departs from the protocol: {departures}" if departures else training


def training_of(trainings: Sequence[tuple[Training, ...]]) -> str:
    """Budget and harness, such as "38 + 23 M steps, harness" for a second stage; of several checkpoints, the range.

    Args:
        trainings: Training of the checkpoints of each result.
    """
    if not any(training.steps for of_result in trainings for training in of_result):
        return "trained elsewhere"
    totals = sorted((t for of_result in trainings for t in of_result), key=lambda training: sum(training.steps))
    budgets = [" + ".join(f"{steps / 1e6:.3g}" for steps in training.steps) for training in totals]
    words = [f"{budgets[0]} M steps" if budgets[0] == budgets[-1] else f"{budgets[0]} to {budgets[-1]} M steps"]
    if any(len(of_result) > 1 for of_result in trainings):
        words.append(f"{len(totals)} checkpoints")
    left = max((t.harness for t in totals if t.harness is not None), default=None)
    words.append("no harness" if left is None else f"harness, {left:.0%} left" if left else "harness")
    return ", ".join(words)


def _partial(result: Result) -> str:
    return f"{result.finished} of {result.trials} trials" if result.partial else ""


def partial_note(results: Sequence[Result]) -> list[str]:
    """A remark if trials of one of the results are missing."""
    said = "partial: trials are missing. Failures end sooner than successes, so the rates are too low."
    return [said] if any(result.partial for result in results) else []
