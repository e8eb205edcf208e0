"""The page: sections of tables, pictures, and sentences on what is missing with the command that makes it."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, ClassVar

from jinja2 import Environment, StrictUndefined

import humoslope
from humoslope.errors import UserError
from humoslope.evaluation.margins import show
from humoslope.evaluation.report.compare import MEASURES, mean_before
from humoslope.evaluation.report.curve import STEPS
from humoslope.evaluation.report.page import pictures
from humoslope.evaluation.report.page.parts import Policy, differing
from humoslope.evaluation.report.page.template import TEMPLATE
from humoslope.evaluation.report.paper import Paper
from humoslope.evaluation.report.results import Result, from_report, with_sweep
from humoslope.evaluation.report.table import Sheet
from humoslope.evaluation.report.tables import ablation_table, causes_table, cells_table, main_table

LONGEST = 90
"""Largest number of characters of a value in the configuration's table."""
FOLDED = 16
"""Largest number of fields that are not folded away."""
SHEET = (480, 270)
"""Width and height of a picture of the contact sheet, pixels."""


@dataclass(frozen=True)
class Row:
    """A row of a table; `aside` if it is there to compare with."""

    cells: list[str]
    aside: bool = False


@dataclass(frozen=True)
class Table:
    """A table with remarks below it, folded away below `fold` if that is not empty; no line of a `tight` one is
    broken."""

    head: list[str]
    rows: list[Row]
    title: str = ""
    notes: Sequence[str] = ()
    fold: str = ""
    tight: bool = False
    kind: ClassVar[str] = "table"


@dataclass(frozen=True)
class Picture:
    """A picture as a data address."""

    uri: str
    caption: str
    kind: ClassVar[str] = "picture"


@dataclass(frozen=True)
class Missing:
    """Something that is not there, and the command that makes it."""

    what: str
    command: str = ""
    kind: ClassVar[str] = "missing"


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str
    kind: ClassVar[str] = "text"


@dataclass(frozen=True)
class Code:
    """Text as it is, folded away below its title."""

    title: str
    text: str
    kind: ClassVar[str] = "code"


Block = Table | Picture | Missing | Text | Code


@dataclass
class Section:
    """A part of the page."""

    key: str
    title: str
    blocks: list[Block] = field(default_factory=list)


def render(
    policies: Sequence[Policy],
    paper: Paper,
    command: str,
    grade: float = 20.0,
    sheet: Callable[[Path, Path], object] | None = None,
) -> str:
    """The page of these policies as HTML that needs no other file.

    Args:
        paper: The paper's tables, to compare with; empty ones for none.
        command: The command that makes the page.
        grade: Grade of table 2 and of the figure along the track, degrees.
        sheet: Draws the contact sheet of a rollout, the first argument, to a file; None for no pictures of walks.
    """
    sections = [
        _overview(policies),
        _configuration(policies),
        _curves(policies),
        _ramps(policies),
        *_track(policies, paper, grade),
        _walks(policies, sheet),
        _margins(policies),
        _provenance(policies),
    ]
    names = [policy.name for policy in policies]
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    now = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")
    return environment.from_string(TEMPLATE).render(
        title=" and ".join(names) if len(names) < 3 else f"{len(names)} policies",
        lead=f"Made by HumoSlope {humoslope.__version__} on {now}: {command}",
        sections=sections,
    )


def _overview(policies: Sequence[Policy]) -> Section:
    rows = []
    for policy in policies:
        success = _success(policy)
        ramps = policy.results.get("ramps")
        fallen = "-"
        if ramps:
            count, total = (sum(r["falls"][key] for r in ramps["ramps"]) for key in ("count", "total"))
            fallen = f"{count} of {total}"
        origin = policy.origin
        rows.append(
            Row(
                [
                    policy.name,
                    origin.task,
                    f"{origin.iteration}",
                    origin.seen.removesuffix(" steps"),
                    fallen,
                    success,
                    origin.training,
                ]
            )
        )
    head = ["policy", "task", "iteration", "steps", "falls on ramps", "success on the track", "help in training"]
    return Section("overview", "Overview", [Table(head, rows)])


def _success(policy: Policy) -> str:
    report = policy.results.get("held-out")
    if not report:
        return "-"
    shares = [(g["grade"], g["summary"]["success"]) for g in report["grades"]]
    rates = ", ".join(f"{100.0 * s['count'] / s['total']:.1f} % at {grade:g}°" for grade, s in shares)
    return (rates or "-") + (" (partial)" if report["finished"] < report["trials"] else "")


def _configuration(policies: Sequence[Policy]) -> Section:
    section = Section("configuration", "Configuration")
    for policy in policies:
        if policy.config is None:
            section.blocks.append(
                Missing(
                    f"{policy.name}: its checkpoint holds no configuration that this version can read; "
                    "one of the first format can be rewritten",
                    _command("upgrade", policy.origin.path),
                )
            )
    if policies[0].default is None:
        section.blocks.append(Missing(f"The task '{policies[0].origin.task}' is not registered here"))
    fields = differing(policies)
    if not fields:
        section.blocks.append(Text("Everything is as in the task."))
        return section
    section.blocks.append(
        Table(
            ["field", "the task's default", *(policy.name for policy in policies)],
            [Row([path, *(_value(value) for value in values)]) for path, values in fields.items()],
            title="What differs from the task as it is today, or between the policies",
            notes=[f"The default is that of {policies[0].origin.task}, without a preset."],
            fold=f"{len(fields)} fields" if len(fields) > FOLDED else "",
        )
    )
    return section


def _value(value: Any) -> str:
    """A value of a configuration in a line; a term as its function with its parameters."""
    if isinstance(value, dict) and "func" in value:
        params = value.get("params") or {}
        text = f"{value['func'].rpartition('.')[2]}({', '.join(f'{k}={_value(v)}' for k, v in params.items())})"
    elif value is None or isinstance(value, str):
        text = value or "-"
    else:
        text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def _curves(policies: Sequence[Policy]) -> Section:
    section = Section("curves", "Learning curves")
    there = {policy.name: policy.curves for policy in policies if policy.curves}
    picture = pictures.of_curves(there) if there else None
    if picture:
        section.blocks.append(
            Picture(picture, "Learning curves against environment steps; smoothed lines over raw ones.")
        )
    known = {name: curves for name, curves in there.items() if STEPS in curves}
    shown = {tag: column for tag, column in MEASURES.items() if any(tag in curves for curves in known.values())}
    if known and shown:
        rows = []
        for name, curves in known.items():
            end = max(curves[STEPS].values())
            values = [mean_before(curves, tag, end) for tag in shown]
            texts = ["-" if v is None else f"{v:.{c.digits}f}" for v, c in zip(values, shown.values(), strict=True)]
            rows.append(Row([name, f"{end / 1e6:.2f} M", *texts]))
        head = ["policy", "steps", *(f"{column.label} {column.unit}".strip() for column in shown.values())]
        section.blocks.append(Table(head, rows, notes=["Means over the last tenth of each run's steps."]))
    for policy in policies:
        if policy.name not in there:
            section.blocks.append(
                Missing(
                    f"{policy.name}: there are no curves (events.out.tfevents.*) beside its checkpoint; "
                    f"training writes them",
                    f"humoslope train {policy.origin.task}",
                )
            )
    return section


def _ramps(policies: Sequence[Policy]) -> Section:
    section = Section("ramps", "Ramps")
    there = {policy.name: policy.results["ramps"] for policy in policies if "ramps" in policy.results}
    if there:
        section.blocks.append(Picture(pictures.of_ramps(there), "Falls and speed on planar ramps."))
    for name, report in there.items():
        rows = [
            Row(
                [
                    f"{r['grade']:+g}°",
                    f"{r['falls']['count']} of {r['falls']['total']}",
                    f"{100.0 * r['falls']['low']:.1f} to {100.0 * r['falls']['high']:.1f} %",
                    *(_number(r.get(key), 3) for key in ("speed", "speed_error", "root_height")),
                ]
            )
            for r in sorted(report["ramps"], key=lambda r: r["grade"])
        ]
        head = ["grade", "falls", "95 % interval", "speed m/s", "error m/s", "pelvis height m"]
        said = report["protocol"]
        note = f"{said['speed']:g} m/s asked for {said['seconds']:g} s; {report.get('command_line', '')}"
        section.blocks.append(Table(head, rows, title=name, notes=[note]))
    section.blocks += _missing(policies, "ramps", "falls and speed on ramps have not been measured", "ramps")
    return section


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _track(policies: Sequence[Policy], paper: Paper, grade: float) -> list[Section]:
    section, figures = Section("track", "Held-out track"), Section("figures", "Figures of the track")
    results = [result for policy in policies if (result := _result(policy)) is not None]
    walked = [result for result in results if result.grades]
    if results:
        section.blocks.append(_sheet(main_table(results, paper)))
    if walked:
        section.blocks += [_sheet(ablation_table(walked, paper, grade)), _sheet(causes_table(walked))]
        section.blocks.append(_sheet(cells_table(walked), "every metric"))
        figures.blocks += [
            Picture(picture, f"{name.replace('_', ' ').capitalize()} on the held-out track.")
            for name, picture in pictures.of_results(walked, grade).items()
        ]
    else:
        figures.blocks.append(Missing("Figures are drawn from trials on the held-out track, of which there are none"))
    section.blocks += _missing(policies, "held-out", "the held-out track has not been walked", "evaluate")
    section.blocks += _missing(policies, "sweep", "the steepest grade has not been searched for", "evaluate", "--sweep")
    return [section, figures]


def _result(policy: Policy) -> Result | None:
    """Trials on the track with the limit of a sweep, as far as there are any."""
    track, sweep = (policy.results.get(kind) for kind in ("held-out", "sweep"))
    try:
        of_sweep = from_report(sweep, policy.name) if sweep else None
        if track is None:
            return of_sweep
        result = from_report(track, policy.name)
    except (KeyError, TypeError, IndexError, ValueError, AttributeError):
        raise UserError(
            f"a result of '{policy.name}' is not one of `humoslope evaluate`, or of another version."
        ) from None
    if of_sweep is None:
        return result
    return with_sweep(result, of_sweep)


def _sheet(sheet: Sheet, fold: str = "") -> Table:
    head = ["method", "training", *(column.title for column in sheet.columns)]
    rows = [Row(texts, row.source != "ours") for texts, row in zip(sheet.texts(), sheet.rows, strict=True)]
    return Table(head, rows, title=sheet.title, notes=sheet.notes, fold=fold, tight=True)


def _walks(policies: Sequence[Policy], sheet: Callable[[Path, Path], object] | None) -> Section:
    section = Section("walks", "Pictures")
    for policy in policies:
        rollout = policy.rollout
        if rollout is None:
            section.blocks.append(
                Missing(f"{policy.name}: no walk has been recorded", _command("record", policy.origin.path))
            )
        elif sheet is None:
            section.blocks.append(
                Missing(f"{policy.name}: pictures of its walk were left out", _command("video", rollout))
            )
        else:
            picture = pictures.of_file(lambda path, rollout=rollout: sheet(rollout, path))  # type: ignore[misc]
            section.blocks.append(Picture(picture, f"{policy.name}: {rollout.name}, at even intervals."))
    return section


def _margins(policies: Sequence[Policy]) -> Section:
    section = Section("margins", "Margins")
    for policy in policies:
        report = policy.results.get("margins")
        if report is None:
            folder = policy.origin.path.with_suffix(".export")
            export = "" if folder.is_dir() else f"{_command('export', policy.origin.path)} && "
            what = f"{policy.name}: the conditions up to which it walks have not been certified"
            section.blocks.append(Missing(what, f"{export}{_command('margins', folder)}"))
            continue
        limits = show.table(report)
        head = [str(column.header) for column in limits.columns]
        rows = [Row([str(cell) for cell in cells]) for cells in zip(*(c.cells for c in limits.columns), strict=True)]
        section.blocks.append(Table(head, rows, title=policy.name, notes=[str(limits.caption)]))
        picture = pictures.of_file(lambda path, report=report: show.draw(report, path))  # type: ignore[misc]
        section.blocks.append(Picture(picture, f"{policy.name}: successes over each quantity, and its limit."))
    return section


def _provenance(policies: Sequence[Policy]) -> Section:
    section = Section("provenance", "Provenance")
    for policy in policies:
        origin = policy.origin
        facts = [
            ("checkpoint", str(origin.path)),
            ("SHA-256", origin.sha256),
            ("trained with", policy.code),
            ("started from", "nothing" if origin.parent is None else f"{origin.parent.path}, {origin.parent.sha256}"),
            *((f"{kind} measured with", r["code"]) for kind, r in policy.results.items() if r.get("code")),
            *((f"{kind} made by", r["command_line"]) for kind, r in policy.results.items() if r.get("command_line")),
            *(("not readable", str(path)) for path in policy.damaged),
        ]
        section.blocks.append(Table(["", ""], [Row(list(fact)) for fact in facts], title=policy.name))
        for number, start in enumerate(policy.starts, start=1):
            told = {key: start[key] for key in ("time", "version", "iteration", "total_steps", "from") if key in start}
            text = f"{json.dumps(told, indent=2)}\noptions: {start['options'] or 'none'}\n\n{start['git']}"
            section.blocks.append(Code(f"start {number} of {policy.name}", text))
    return section


def _missing(policies: Sequence[Policy], kind: str, what: str, verb: str, *options: str) -> list[Missing]:
    return [
        Missing(f"{policy.name}: {what}", _command(verb, policy.origin.path, *options))
        for policy in policies
        if kind not in policy.results
    ]


def _command(verb: str, path: Path, *options: str) -> str:
    return shlex.join(["humoslope", verb, str(path), *options])
