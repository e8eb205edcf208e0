"""`humoslope table WHICH RESULT ...`: the paper's tables with the results of `humoslope evaluate`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Literal

import tyro

from humoslope.cli.arguments import parse_options
from humoslope.errors import UserError, unknown
from humoslope.evaluation.report.paper import Paper, read_paper
from humoslope.evaluation.report.results import Method, Result, read_methods
from humoslope.evaluation.report.seed_tables import ablation_over_seeds, differences, main_over_seeds
from humoslope.evaluation.report.table import Sheet
from humoslope.evaluation.report.tables import (
    ablation_table,
    causes_table,
    cells_table,
    diagnostics_table,
    main_table,
)
from humoslope.files import check_place, write_text
from humoslope.ranges import Checked, Finite


@dataclasses.dataclass(frozen=True)
class Options(Checked):
    """Prints a table of several methods, with the paper's row below each of ours.

    Attributes:
        which: Table to print. "1": success, distance and time at each grade; "2": efficiency, stability, posture and
            load at one grade; "diagnostics": posture and load uphill, on the flat and downhill; "causes": why trials
            failed, at each grade; "cells": every metric by grade and friction.
        results: JSON files of `humoslope evaluate`, as FILE or NAME=FILE, or folders of them. A row of the paper is put
            below a method by its task, or by the name given here. The file of a sweep adds the maximal grade. Several
            results of one name are of one method with several seeds: tables 1 and 2 then have intervals over seeds and
            trials, and a table of differences from the first method. The folder of a campaign stands for its results.
        grade: Grade of table 2, of the differences and of the diagnostics, degrees; the paper's is 20.
        against: Name of the method that the others are compared with over seeds; by default the first one.
        out: Path without ending of files for the table too, as .md, .csv and .json.
    """

    VERB: ClassVar[str] = "table"

    which: tyro.conf.Positional[Literal["1", "2", "diagnostics", "causes", "cells"]]
    results: tyro.conf.Positional[tuple[str, ...]]
    grade: Finite = 20.0
    against: str = ""
    out: Path | None = None


def run(arguments: list[str]) -> None:
    """Prints the table named in `arguments`."""
    options = parse_options(Options, arguments, "table")
    methods = read_methods(options.results)
    sheets = _sheets(options, methods, read_paper())
    paths: dict[Path, Callable[[], str]] = {}
    for end, sheet in sheets.items():
        if options.out is not None:
            writers = {".md": sheet.to_markdown, ".csv": sheet.to_csv, ".json": sheet.to_json}
            paths |= {options.out.with_name(options.out.name + end + suffix): to for suffix, to in writers.items()}
    for path in paths:
        check_place(path)

    for sheet in sheets.values():
        sheet.show()
    for path, write in paths.items():
        write_text(path, write())
        print(f"wrote {path}")


def _sheets(options: Options, methods: list[Method], paper: Paper) -> dict[str, Sheet]:
    """Tables by what is added to the names of their files."""
    several = any(len(method.runs) > 1 for method in methods)
    if options.against:
        if not several:
            raise UserError("--against: there is one result of each method; differences need several seeds.")
        first = [method for method in methods if method.name == options.against]
        if not first:
            raise unknown("method", options.against, (method.name for method in methods))
        methods = [*first, *(method for method in methods if method is not first[0])]
    if several and options.which in ("1", "2"):
        table = (
            main_over_seeds(methods, paper)
            if options.which == "1"
            else ablation_over_seeds(methods, paper, options.grade)
        )
        return {"": table} | ({"-differences": differences(methods, options.grade)} if len(methods) > 1 else {})
    return {"": _sheet(options, [run for method in methods for run in _told_apart(method)], paper)}


def _told_apart(method: Method) -> list[Result]:
    """The results of a method; several ones with a number each."""
    if len(method.runs) == 1:
        return [*method.runs]
    return [replace(run, name=f"{method.name}, {i + 1} of {len(method.runs)}") for i, run in enumerate(method.runs)]


def _sheet(options: Options, results: list[Result], paper: Paper) -> Sheet:
    if options.which == "1":
        return main_table(results, paper)
    if options.which == "2":
        return ablation_table(results, paper, options.grade)
    if options.which == "diagnostics":
        return diagnostics_table(results, options.grade)
    return causes_table(results) if options.which == "causes" else cells_table(results)
