"""Tables of methods that were trained with several seeds, and of the differences between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from humoslope.evaluation.report.paper import Paper, PaperRow
from humoslope.evaluation.report.results import Grade, Method
from humoslope.evaluation.report.seeds import ENOUGH_FOR_IQM, Estimate, Scores, Trials
from humoslope.evaluation.report.table import Column, Row, Sheet, Value
from humoslope.evaluation.report.tables import (
    ABLATION,
    BEYOND,
    GRADES,
    LATER,
    LIMIT_NOTE,
    MORE,
    PAPER_NOTE,
    TASK,
    metric_notes,
    note_of,
    partial_note,
    their_figures,
)
from humoslope.evaluation.track.metrics import REPORTED
from humoslope.statistics import Average, Proportion

BOUNDS = {"success": (0.0, 1.0), "self_contact": (0.0, 100.0)}
"""Bounds of metrics that have any."""
BETTER = {
    **dict.fromkeys(("success", "max_distance", "com_height"), 1.0),
    **dict.fromkeys(("cost_of_transport", "yaw_rate_variance", "knee_peak", "knee_p99"), -1.0),
    **dict.fromkeys(("speed_error", "self_contact"), -1.0),
}
"""Sign of a difference for the better; a metric that is not listed is only higher or lower."""

SEEDS_NOTE = (
    "Means over seeds, each with the same weight. Intervals: 95 %, by a hierarchical bootstrap over seeds and trials, "
    "widened for few seeds by Student's t."
)
SR_NOTE = "SR: share of trials that reach the goal; all friction tiers together."
ONE_SEED_NOTE = "One seed: its interval is over trials alone, and says nothing about another training."
CHANCE_NOTE = (
    "Better or worse is said only where the interval of the difference is on one side of zero. Each interval stands "
    "for itself: of twenty comparisons of methods that are alike, one may be so by chance."
)


def ablation_over_seeds(methods: Sequence[Method], paper: Paper, grade: float = 20.0) -> Sheet:
    """Table 2 with intervals over seeds and trials."""
    rows = paper.ablation if grade == paper.ablation_grade else ()
    names = _names(methods, (*ABLATION, *MORE))
    return _table(f"Variants at {grade:g}° over seeds (paper, table 2)", methods, rows, [grade], names, limit=False)


def main_over_seeds(methods: Sequence[Method], paper: Paper) -> Sheet:
    """Table 1 with intervals over seeds and trials."""
    grades = sorted({at.grade for method in methods for run in method.runs for at in run.grades}) or list(GRADES)
    title = "Held-out slope tracks over seeds (paper, table 1)"
    return _table(title, methods, paper.main, grades, _names(methods, TASK), limit=True)


def differences(methods: Sequence[Method], grade: float = 20.0) -> Sheet:
    """How the methods differ from the first one at a grade, and whether the seeds carry that."""
    first, others = methods[0], methods[1:]
    names = _names(methods, (*ABLATION, *MORE))
    rows = []
    for method in others:
        found = [_difference(method, first, grade, name) for name in names]
        words = [_verdict(name, difference) for name, difference in zip(names, found, strict=True)]
        seeds = f"{len(method.runs)} - {len(first.runs)} seeds"
        rows.append(Row(method.name, seeds, tuple(found)))
        rows.append(Row(method.name, seeds, tuple(words), more=True))
    columns = [replace(column, signed=True) for column in _columns(names, "")]
    count = sum(isinstance(value, Estimate) and value.seeds > 1 for row in rows for value in row.values)
    return Sheet(
        title=f"Differences from {first.name} at {grade:g}°",
        columns=tuple(columns),
        rows=tuple(rows),
        notes=(SEEDS_NOTE, CHANCE_NOTE, f"Comparisons here: {count}.", *_one_seed_note(methods)),
    )


def _table(
    title: str,
    methods: Sequence[Method],
    printed: Sequence[PaperRow],
    grades: Sequence[float],
    names: Sequence[str],
    limit: bool,
) -> Sheet:
    rows, left = [], list(printed)
    for method in methods:
        note = note_of(method.runs)
        partial = _partial(method)
        seeds = len(method.runs)
        figures = [_figure(method, grade, name) for grade in grades for name in names]
        limits: list[Value] = [_limit(method)] if limit else []
        told = f"{seeds} seeds, {note}" if seeds > 1 else f"1 seed, {note}"
        rows.append(Row(method.name, told, (*figures, *limits), partial=partial))
        if seeds >= ENOUGH_FOR_IQM:
            middle = [_figure(method, grade, name, iqm=True) for grade in grades for name in names]
            empty: list[Value] = [None] if limit else []
            rows.append(Row(f"{method.name}, IQM", "interquartile mean of the seeds", (*middle, *empty)))
        for row in printed:
            if row.matches(method.runs[0]):
                theirs = [figure for grade in grades for figure in their_figures(row, grade, names)]
                rows.append(Row(row.name, "", (*theirs, *([row.max_grade] if limit else [])), source="paper"))
                left = [other for other in left if other is not row]
    for row in left:
        theirs = [figure for grade in grades for figure in their_figures(row, grade, names)]
        rows.append(Row(row.name, "", (*theirs, *([row.max_grade] if limit else [])), source="paper"))
    columns = [column for grade in grades for column in _columns(names, f"{grade:g}°" if len(grades) > 1 else "")]
    if limit:
        columns.append(Column("max grade", "°", 1, interval=True))
    runs = [run for method in methods for run in method.runs]
    notes = (
        SEEDS_NOTE,
        *_one_seed_note(methods),
        SR_NOTE,
        *metric_notes(runs, grades, names),
        *([LIMIT_NOTE, *_beyond_notes(methods)] if limit else []),
        *([PAPER_NOTE] if printed else []),
        *partial_note(runs),
    )
    return Sheet(title=title, columns=tuple(columns), rows=tuple(rows), notes=notes)


def _names(methods: Sequence[Method], names: Sequence[str]) -> list[str]:
    measured = {name for method in methods for run in method.runs for at in run.grades for name in at.summary}
    return [*names, *(name for name in LATER if name in measured)]


def _columns(names: Sequence[str], group: str) -> list[Column]:
    metrics = [REPORTED[name] for name in names]
    return [Column(m.label, m.unit, m.digits, group, interval=True) for m in metrics]


def _figure(method: Method, grade: float, name: str, iqm: bool = False) -> Value:
    """A figure over the seeds of a method; of a single seed, that of its result."""
    if len(method.runs) == 1:
        at = method.runs[0].at(grade)
        return None if at is None else at.summary.get(name)
    scores = _scores(method, grade, name)
    if scores is None:
        return None
    bounds = BOUNDS.get(name, (-np.inf, np.inf))
    return _shown(name, scores.interquartile_mean(*bounds) if iqm else scores.estimate(*bounds))


def _difference(method: Method, first: Method, grade: float, name: str) -> Estimate | None:
    mine, theirs = _scores(method, grade, name), _scores(first, grade, name)
    return None if mine is None or theirs is None else _shown(name, mine.minus(theirs))


def _verdict(name: str, difference: Estimate | None) -> str | None:
    """What may be said of a difference."""
    if difference is None:
        return None
    if difference.seeds == 1:
        return "one seed"
    if not difference.separate:
        return "not separable"
    if name not in BETTER:
        return "higher" if difference.value > 0.0 else "lower"
    return "better" if difference.value * BETTER[name] > 0.0 else "worse"


def _shown(name: str, estimate: Estimate) -> Estimate:
    """Shares in percent, as in all tables."""
    if name != "success":
        return estimate
    ends = [None if end is None else 100.0 * end for end in (estimate.low, estimate.high)]
    return replace(estimate, value=100.0 * estimate.value, low=ends[0], high=ends[1])


def _scores(method: Method, grade: float, name: str) -> Scores | None:
    there = [at for run in method.runs if (at := run.at(grade)) is not None]
    trials = [found for at in there if (found := _trials(at, name)) is not None]
    return Scores(trials, f"{method.name} {name} {grade:g}") if trials else None


def _trials(at: Grade, name: str) -> Trials | None:
    """Trials of a seed; its figure as a single one where the result does not hold them."""
    figure = at.summary.get(name)
    if figure is None:
        return None
    if name == "cost_of_transport":
        each, weights = at.each("weight_work"), at.each("distance")
    else:
        each, weights = at.each(name), None
    if each is not None:
        return Trials.of(each, weights, shares=name == "success")
    if isinstance(figure, Proportion):
        return Trials(np.array([float(figure.count)]), np.array([float(figure.total)]))
    return Trials.of(np.array([figure.mean if isinstance(figure, Average) else float(figure)]))


def _limit(method: Method) -> Value:
    """Steepest grade, averaged over the seeds that were swept; None where the limit of one of them is not known."""
    limits = [run.limit for run in method.runs if run.swept]
    if len(method.runs) == 1:
        return method.runs[0].limit
    if any(run.beyond for run in method.runs):
        return None
    known = [limit for limit in limits if limit is not None]
    if not known or len(known) < len(limits):
        return None
    return Scores([Trials(np.array([limit]), np.ones(1)) for limit in known], f"{method.name} limit").estimate()


def _beyond_notes(methods: Sequence[Method]) -> list[str]:
    """Remarks on limits that may lie beyond a sweep."""
    notes = []
    for method in methods:
        beyond = [run.limit for run in method.runs if run.beyond]
        if beyond and len(method.runs) == 1:
            notes.append(f"{method.name}: {BEYOND}")
        elif beyond:
            seeds = f"{len(beyond)} of {len(method.runs)} seeds"
            notes.append(f"{method.name}: the sweep of {seeds} ends at their limit, which may be higher: no mean.")
    return notes


def _partial(method: Method) -> str:
    finished, trials = (sum(getattr(run, name) for run in method.runs) for name in ("finished", "trials"))
    return f"{finished} of {trials} trials" if method.partial else ""


def _one_seed_note(methods: Sequence[Method]) -> list[str]:
    return [ONE_SEED_NOTE] if any(len(method.runs) == 1 for method in methods) else []
