"""`humoslope compare RUN ...`: training runs side by side after equally many environment steps."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import tyro

from humoslope.errors import UserError
from humoslope.evaluation.report.compare import compare
from humoslope.files import check_place, write_text
from humoslope.learning.run_folder import saved_options
from humoslope.words import option_groups


@dataclasses.dataclass(frozen=True)
class Options:
    """Prints a table of training runs, with the options in which they differ.

    Attributes:
        runs: Paths of run folders.
        at: Number of environment steps after which they are compared; 0 for as many as the shortest run has.
        out: Path of a file for the table too, as Markdown (.md) or CSV (.csv).
    """

    runs: tyro.conf.Positional[tuple[Path, ...]]
    at: float = 0.0
    out: Path | None = None


def run(arguments: list[str]) -> None:
    """Compares the runs named in `arguments`."""
    options = tyro.cli(Options, args=arguments, prog="humoslope compare")
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
