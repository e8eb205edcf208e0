"""`humoslope table WHICH RESULT ...`: the paper's tables with the results of `humoslope evaluate`."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import ClassVar, Literal

import tyro

from humoslope.cli.arguments import parse_options
from humoslope.evaluation.report.paper import Paper, read_paper
from humoslope.evaluation.report.results import Result, read_results
from humoslope.evaluation.report.table import Sheet
from humoslope.evaluation.report.tables import ablation_table, cells_table, diagnostics_table, main_table
from humoslope.files import check_place, write_text
from humoslope.ranges import Checked, Finite


@dataclasses.dataclass(frozen=True)
class Options(Checked):
    """Prints a table of several methods, with the paper's row below each of ours.

    Attributes:
        which: Table to print. "1": success, distance and time at each grade; "2": efficiency, stability, posture and
            load at one grade; "diagnostics": posture and load uphill, on the flat and downhill; "cells": every metric
            by grade and friction.
        results: JSON files of `humoslope evaluate`, as FILE or NAME=FILE, or folders of them. A row of the paper is put
            below a method by its task, or by the name given here. The file of a sweep adds the maximal grade.
        grade: Grade of table 2 and of the diagnostics, degrees; the paper's is 20.
        out: Path without ending of files for the table too, as .md, .csv and .json.
    """

    VERB: ClassVar[str] = "table"

    which: tyro.conf.Positional[Literal["1", "2", "diagnostics", "cells"]]
    results: tyro.conf.Positional[tuple[str, ...]]
    grade: Finite = 20.0
    out: Path | None = None


def run(arguments: list[str]) -> None:
    """Prints the table named in `arguments`."""
    options = parse_options(Options, arguments, "table")
    sheet = _sheet(options, read_results(options.results), read_paper())
    writers = {".md": sheet.to_markdown, ".csv": sheet.to_csv, ".json": sheet.to_json}
    paths = {} if options.out is None else {options.out.with_name(options.out.name + end): end for end in writers}
    for path in paths:
        check_place(path)

    sheet.show()
    for path, end in paths.items():
        write_text(path, writers[end]())
        print(f"wrote {path}")


def _sheet(options: Options, results: list[Result], paper: Paper) -> Sheet:
    if options.which == "1":
        return main_table(results, paper)
    if options.which == "2":
        return ablation_table(results, paper, options.grade)
    return diagnostics_table(results, options.grade) if options.which == "diagnostics" else cells_table(results)
