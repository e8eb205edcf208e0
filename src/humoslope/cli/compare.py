"""`humoslope compare RUN ...`: training runs side by side after equally many environment steps."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from humoslope.cli.arguments import parse_options
from humoslope.cli.overrides import option_groups
from humoslope.errors import UserError
from humoslope.evaluation.report.compare import compare
from humoslope.files import check_place, write_text
from humoslope.learning.run_folder import saved_options
from humoslope.ranges import Checked, Range


@dataclasses.dataclass(frozen=True)
class Options(Checked):
    """Prints a table of training runs, with the options in which they differ.

    Attributes:
        runs: Paths of run folders.
        at: Number of environment steps after which they are compared; 0 for as many as the shortest run has.
        out: Path of a file for the table too, as Markdown (.md) or CSV (.csv).
    """

    VERB: ClassVar[str] = "compare"

    runs: tyro.conf.Positional[tuple[Path, ...]]
    at: Annotated[float, Range(0.0, 1e15)] = 0.0
    out: Path | None = None


def run(arguments: list[str]) -> None:
    """Compares the runs named in `arguments`."""
    options = parse_options(Options, arguments, "compare")
    if not options.runs:
        raise UserError("compare needs one run folder or more.")
    if options.out is not None:
        if options.out.suffix not in (".md", ".csv"):
            raise UserError(f"the table '{options.out}' must end in .md or .csv.")
        check_place(options.out)
    sheet = compare(options.runs, [_groups(folder) for folder in options.runs], options.at)
    sheet.show()
    if options.out is not None:
        write_text(options.out, sheet.to_markdown() if options.out.suffix == ".md" else sheet.to_csv())
        print(f"wrote {options.out}")


def _groups(run_dir: Path) -> list[str]:
    return [" ".join(words) for words in option_groups(saved_options(run_dir)).values()]
