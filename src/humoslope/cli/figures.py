"""`humoslope figures RESULT ...`: figures of the results of `humoslope evaluate`."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import ClassVar

import tyro

from humoslope.cli.arguments import parse_options
from humoslope.evaluation.report.figures import draw_all
from humoslope.evaluation.report.results import read_results
from humoslope.files import check_place
from humoslope.ranges import Checked, Finite


@dataclasses.dataclass(frozen=True)
class Options(Checked):
    """Draws, for several methods at once: the height of the centre of mass by grade, success by grade and friction, how
    far the trials came, and hip torque and knee flexion along the track.

    Attributes:
        results: JSON files of `humoslope evaluate`, as FILE or NAME=FILE, or folders of them.
        out: Path of the folder for the pictures.
        grade: Grade of the figure along the track, degrees.
    """

    VERB: ClassVar[str] = "figures"

    results: tyro.conf.Positional[tuple[str, ...]]
    out: Path = Path("figures")
    grade: Finite = 20.0


def run(arguments: list[str]) -> None:
    """Draws the results named in `arguments`."""
    options = parse_options(Options, arguments, "figures")
    results = read_results(options.results)
    check_place(options.out / "success.png")
    for path in draw_all(results, options.out, options.grade):
        print(f"wrote {path}")
