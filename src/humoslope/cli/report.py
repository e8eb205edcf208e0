"""`humoslope report RUN ...`: one HTML page of a training run, or of a comparison."""

from __future__ import annotations

import dataclasses
import shlex
from pathlib import Path

import tyro

from humoslope.errors import UserError
from humoslope.evaluation.report.page.page import SHEET, render
from humoslope.evaluation.report.page.parts import find_policies
from humoslope.evaluation.report.paper import Paper, read_paper
from humoslope.files import check_place, write_text
from humoslope.registry import load_content


@dataclasses.dataclass(frozen=True)
class Options:
    """Writes one HTML page that needs no other file: configuration, curves, ramps, track, figures, pictures of a walk,
    margins and provenance of one or several policies. What has not been measured is said, with the command for it.

    Attributes:
        runs: Run folders, or checkpoints, as PATH or NAME=PATH. The newest checkpoint of a folder counts.
        also: Files and folders with further results. Those beside a checkpoint are found by themselves; they all belong
            to it by its SHA-256, whatever their names are.
        out: Path of the page; by default report.html beside the first checkpoint.
        grade: Grade of table 2 and of the figure along the track, degrees; the paper's is 20.
        paper: Show the paper's rows in the tables of the track.
        pictures: Draw pictures of the recorded walks.
    """

    runs: tyro.conf.Positional[tuple[str, ...]] = ()
    also: tuple[Path, ...] = ()
    out: Path | None = None
    grade: float = 20.0
    paper: bool = True
    pictures: bool = True


def run(arguments: list[str]) -> None:
    """Writes the page of the runs named in `arguments`."""
    options = tyro.cli(Options, args=arguments, prog="humoslope report")
    if not options.runs:
        raise UserError(
            "report needs a run folder or a checkpoint, such as logs/... or experiments/checkpoints/stage2.pt."
        )
    load_content()
    policies = find_policies(options.runs, options.also)
    out = options.out or policies[0].origin.path.with_name("report.html")
    if out.suffix not in (".html", ".htm"):
        raise UserError(f"--out '{out}' must end in .html.")
    check_place(out)
    page = render(
        policies,
        read_paper() if options.paper else Paper(),
        shlex.join(["humoslope", "report", *arguments]),
        options.grade,
        _draw_sheet if options.pictures else None,
    )
    write_text(out, page)
    print(f"wrote {out} ({out.stat().st_size / 1e6:.1f} MB)")


def _draw_sheet(rollout: Path, path: Path) -> None:
    # What draws is only needed where there is a walk.
    from humoslope.replay.film.video import VideoCfg, write_sheet
    from humoslope.replay.rollout import load_rollout

    write_sheet(load_rollout(rollout), path, VideoCfg(width=SHEET[0], height=SHEET[1], workers=1))
