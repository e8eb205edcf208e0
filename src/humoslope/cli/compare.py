"""`humoslope compare RUN ...`: training runs side by side after equally many environment steps."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from humoslope.cli.arguments import parse_options
from humoslope.errors import UserError
from humoslope.evaluation.report.bands import draw_bands
from humoslope.evaluation.report.compare import TrainingRun, compare
from humoslope.evaluation.report.results import by_row
from humoslope.files import check_place, write_text
from humoslope.learning.run_folder import saved_options, start_of
from humoslope.plotting import with_ending
from humoslope.ranges import Checked, Range
from humoslope.words import option_groups


@dataclasses.dataclass(frozen=True)
class Options(Checked):
    """Prints a table of training runs, with the options in which they differ.

    Runs that differ in their seed alone are one row, with an interval over seeds, and a second table says which of the
    differences from the first row the seeds carry.

    Attributes:
        runs: Paths of run folders; the folder of a campaign stands for all of its runs.
        at: Number of environment steps after which they are compared; 0 for as many as the shortest run has.
        each: Give every run a row of its own.
        out: Path of a file for the table too, as Markdown (.md) or CSV (.csv).
        curves: Path of a picture of the learning curves: of each row the mean over its seeds, in a band from the lowest
            to the highest seed.
    """

    VERB: ClassVar[str] = "compare"

    runs: tyro.conf.Positional[tuple[Path, ...]]
    at: Annotated[float, Range(0.0, 1e15)] = 0.0
    each: bool = False
    out: Path | None = None
    curves: Path | None = None


def run(arguments: list[str]) -> None:
    """Compares the runs named in `arguments`."""
    options = parse_options(Options, arguments, "compare")
    if not options.runs:
        raise UserError("compare needs one run folder or more.")
    if options.out is not None:
        if options.out.suffix not in (".md", ".csv"):
            raise UserError(f"the table '{options.out}' must end in .md or .csv.")
        check_place(options.out)
    curves = options.curves and with_ending(options.curves)
    if curves is not None:
        check_place(curves)
    folders = [folder for path in options.runs for folder in _folders(path)]
    for i, folder in enumerate(folders):
        if folder.resolve() in (other.resolve() for other in folders[:i]):
            raise UserError(f"compare: run '{folder}' is given twice; it would count twice.")
    runs = [_read(folder) for folder in folders]
    sheets = compare(runs, options.at, options.each)
    for sheet in sheets:
        sheet.show()
    if options.out is not None:
        texts = [sheet.to_markdown() if options.out.suffix == ".md" else sheet.to_csv() for sheet in sheets]
        write_text(options.out, "\n".join(texts))
        print(f"wrote {options.out}")
    if curves is not None:
        draw_bands(runs, curves, options.at)
        print(f"wrote {curves}")


def _folders(path: Path) -> list[Path]:
    """The run folders of a campaign, or the folder itself."""
    found = [folder for folder in path.glob("*/seed*") if any(folder.glob("model_*.pt"))]
    return by_row(path, found, lambda folder: folder) or [path]


def _read(folder: Path) -> TrainingRun:
    groups = option_groups(saved_options(folder))
    about = start_of(folder) or {}
    return TrainingRun(folder, about.get("task", ""), {name: " ".join(words) for name, words in groups.items()})
