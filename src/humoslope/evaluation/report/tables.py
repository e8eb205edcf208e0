"""The paper's tables with our figures in them, and the paper's below each of ours."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from humoslope.evaluation.report.paper import Paper, PaperRow
from humoslope.evaluation.report.results import Grade, Result
from humoslope.evaluation.report.table import Column, Row, Sheet, Value
from humoslope.evaluation.track.summary import DIRECTIONS

GRADES = (0.0, 10.0, 20.0, 30.0)
"""Degrees; the paper's four nominal grades, shown where nothing was walked."""
PAPER_NOTE = "paper: as printed there, on another track in another simulator; its training budget is not stated."
SR_NOTE = "SR: share of trials that reach the goal, with Wilson's 95 % interval; all friction tiers together."
MEAN_NOTE = "±: 95 % of the mean over trials of this policy on this track, by Student's t."
SPEED_NOTE = "T_trav is over successes. At the commanded 0.5 m/s it is about 62 s; less is over-speed, not precision."

TASK_COLUMNS = (
    Column("SR", "%", 1, interval=True),
    Column("MXD", "m", interval=True),
    Column("T_trav", "s", 1, interval=True),
)
TASK_KEYS = ("sr", "mxd", "t_trav")


def main_table(results: Sequence[Result], paper: Paper) -> Sheet:
    """Table 1: success rate, furthest distance and time at each grade, and the steepest grade."""
    grades = sorted({there.grade for result in results for there in result.grades}) or list(GRADES)
    columns = [replace(column, group=f"{grade:g}°") for grade in grades for column in TASK_COLUMNS]

    def ours(result: Result) -> tuple[Value, ...]:
        figures = [value for grade in grades for value in _task_figures(result.at(grade))]
        return (*figures, result.limit)

    def theirs(row: PaperRow) -> tuple[Value, ...]:
        figures = [row.grades.get(grade, {}).get(key) for grade in grades for key in TASK_KEYS]
        return (*figures, row.max_grade)

    notes = [SR_NOTE, MEAN_NOTE, SPEED_NOTE, "Max grade: steepest with SR of 50 % and more in the slope-limit sweep."]
    notes += [f"{r.name}: the sweep ends there, the limit may be higher." for r in results if r.beyond]
    return Sheet(
        title="Held-out slope tracks (paper, table 1)",
        columns=(*columns, Column("max grade", "°", 0)),
        rows=_beside(results, paper.main, ours, theirs),
        notes=(*notes, PAPER_NOTE, *_partial_note(results)),
    )


ABLATION_COLUMNS = (
    Column("CoT", digits=3),
    Column("σ²_yaw", "rad²/s²", 4, interval=True),
    Column("h_com", "m", 3, interval=True),
    Column("τ_knee", "Nm", 1, interval=True),
)
ABLATION_KEYS = ("cot", "yaw_rate_variance", "com_height", "knee_peak")
OUR_COLUMNS = (
    Column("τ p99", "Nm", 1),
    Column("speed", "m/s", 3, interval=True),
    Column("error", "m/s", 3, interval=True),
)
"""What the paper does not tell."""


def ablation_table(results: Sequence[Result], paper: Paper, grade: float = 20.0) -> Sheet:
    """Table 2: task performance, efficiency, stability, posture and load at one grade, by default the paper's."""

    def ours(result: Result) -> tuple[Value, ...]:
        there = result.at(grade)
        if there is None:
            return (None,) * (len(TASK_KEYS) + len(ABLATION_COLUMNS) + len(OUR_COLUMNS))
        s = there.summary
        diagnostics = (s.cost_of_transport, s.yaw_rate_variance, s.com_height, s.knee_peak)
        return (*_task_figures(there), *diagnostics, s.knee_p99, s.speed, s.speed_error)

    def theirs(row: PaperRow) -> tuple[Value, ...]:
        figures = row.grades.get(grade, {})
        return (*(figures.get(key) for key in (*TASK_KEYS, *ABLATION_KEYS)), *(None for _ in OUR_COLUMNS))

    return Sheet(
        title=f"Variants at {grade:g}° (paper, table 2)",
        columns=(*TASK_COLUMNS, *ABLATION_COLUMNS, *OUR_COLUMNS),
        rows=_beside(results, paper.ablation if grade == paper.ablation_grade else (), ours, theirs),
        notes=(
            SR_NOTE,
            MEAN_NOTE,
            SPEED_NOTE,
            "CoT: sum of |torque x velocity| over weight and forward way, all trials. τ_knee: mean of trials' peaks.",
            "h_com: above the ground below the centre of mass. error: of a trial's mean speed from the commanded one.",
            PAPER_NOTE,
            *_partial_note(results),
        ),
    )


DIAGNOSTIC_COLUMNS = (
    Column("on"),
    Column("torso pitch", "°", 1),
    Column("knee flexion", "°", 1),
    Column("hip", "Nm", 1, group="torque"),
    Column("knee", "Nm", 1, group="torque"),
    Column("ankle", "Nm", 1, group="torque"),
    Column("hip", digits=2, group="work +"),
    Column("knee", digits=2, group="work +"),
    Column("ankle", digits=2, group="work +"),
    Column("hip", digits=2, group="work -"),
    Column("knee", digits=2, group="work -"),
    Column("ankle", digits=2, group="work -"),
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
            rows.append(Row(result.name, _training(result), values, partial=_partial(result), more=i > 0))
    return Sheet(
        title=f"Posture and load by direction at {grade:g}°",
        columns=DIAGNOSTIC_COLUMNS,
        rows=tuple(rows),
        notes=(
            "Pitch joints of both legs, all friction tiers, all trials. torque: mean |torque| of one joint.",
            "work +, -: share of each in the positive and in the negative work of the three.",
            *_partial_note(results),
        ),
    )


CELL_COLUMNS = (
    Column("grade", "°", 0),
    Column("friction"),
    *TASK_COLUMNS,
    Column("fell", digits=0),
    Column("left", digits=0),
    Column("timed out", digits=0),
    Column("speed", "m/s", 3, interval=True),
    Column("error", "m/s", 3, interval=True),
    Column("RMS", "m/s", 3),
    Column("CoT", digits=3),
    Column("CoT of successes", digits=3),
    Column("CoT +", digits=3),
    Column("σ²_yaw", "rad²/s²", 4, interval=True),
    Column("h_com", "m", 3, interval=True),
    Column("h_root", "m", 3, interval=True),
    Column("τ_knee", "Nm", 1, interval=True),
    Column("τ max", "Nm", 1),
    Column("τ p99", "Nm", 1),
)


def cells_table(results: Sequence[Result]) -> Sheet:
    """Every figure at each grade and friction."""
    rows = []
    for result in results:
        for i, cell in enumerate(result.cells):
            s = cell.summary
            values: tuple[Value, ...] = (
                cell.grade,
                math.tan(math.radians(cell.grade)) + cell.tier,
                s.success,
                s.max_distance,
                s.traversal_s,
                s.fell,
                s.left,
                s.timed_out,
                s.speed,
                s.speed_error,
                s.speed_rms_error,
                s.cost_of_transport,
                s.cost_of_transport_successes,
                s.cost_of_transport_positive,
                s.yaw_rate_variance,
                s.com_height,
                s.root_height,
                s.knee_peak,
                s.knee_max,
                s.knee_p99,
            )
            rows.append(Row(result.name, _training(result), values, partial=_partial(result), more=i > 0))
    return Sheet(
        title="By grade and friction",
        columns=CELL_COLUMNS,
        rows=tuple(rows),
        notes=(
            MEAN_NOTE,
            "CoT +: of positive work alone. τ_knee: mean of the trials' peaks.",
            *_partial_note(results),
        ),
    )


def _beside(
    results: Sequence[Result],
    printed: Sequence[PaperRow],
    ours: Callable[[Result], tuple[Value, ...]],
    theirs: Callable[[PaperRow], tuple[Value, ...]],
) -> tuple[Row, ...]:
    """Our rows with the paper's below each, and then those of the paper that none of ours stands for."""
    rows, left = [], list(printed)
    for result in results:
        rows.append(Row(result.name, _training(result), ours(result), partial=_partial(result)))
        for row in printed:
            if row.matches(result):
                rows.append(Row(row.name, "", theirs(row), paper=True))
                left = [other for other in left if other is not row]
    return (*rows, *(Row(row.name, "", theirs(row), paper=True) for row in left))


def _task_figures(there: Grade | None) -> tuple[Value, ...]:
    if there is None:
        return (None,) * len(TASK_KEYS)
    return there.summary.success, there.summary.max_distance, there.summary.traversal_s


def _training(result: Result) -> str:
    """Budget and harness, such as "38 + 23 M steps, harness" for a second stage; of several checkpoints, the range."""
    totals = sorted(result.training, key=lambda training: sum(training.steps))
    budgets = [" + ".join(f"{steps / 1e6:.3g}" for steps in training.steps) for training in totals]
    words = [f"{budgets[0]} M steps" if budgets[0] == budgets[-1] else f"{budgets[0]} to {budgets[-1]} M steps"]
    if len(totals) > 1:
        words.append(f"{len(totals)} checkpoints")
    left = max((t.harness for t in totals if t.harness is not None), default=None)
    words.append("no harness" if left is None else f"harness, {left:.0%} left" if left else "harness")
    return ", ".join(words)


def _partial(result: Result) -> str:
    return f"{result.finished} of {result.trials} trials" if result.partial else ""


def _partial_note(results: Sequence[Result]) -> list[str]:
    said = "partial: trials are missing. Failures end sooner than successes, so the rates are too low."
    return [said] if any(result.partial for result in results) else []
