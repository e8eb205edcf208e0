"""`humoslope accept DIR`: whether an exported policy meets what an owner of the robot would demand."""

from __future__ import annotations

import dataclasses
import shlex
import sys
from pathlib import Path
from typing import Annotated, ClassVar, get_args

import tyro
from rich.console import Console

from humoslope.cli.arguments import parse_options
from humoslope.cli.margins import run_trials
from humoslope.deploy import contract as contracts
from humoslope.deploy.conditions import NOMINAL
from humoslope.errors import UserError
from humoslope.evaluation.margins.acceptance import Acceptance, table
from humoslope.evaluation.margins.demands import Name
from humoslope.files import check_place
from humoslope.ranges import Checked, Count, NotEmpty, Range, Seed
from humoslope.seal import write_json


@dataclasses.dataclass(frozen=True)
class Options(Checked):
    """Checks in plain MuJoCo whether an exported policy meets what is demanded of one that is to walk on a robot:
    standing still, all directions, slopes across, pushes, delays, other physics steps, a calm and upright gait.

    Finished trials are kept, so that the same command continues after an interruption. The exit code is 1 if a demand
    is not met.

    Attributes:
        folder: Folder that `humoslope export` wrote.
        demands: Names of the demands to check.
        trials: Trials of each case.
        model: MJCF of another robot with joints of the same names, to examine the policy on instead of its own model.
        seconds: Length of a trial, s; the first push comes after 5 s.
        seed: Seed of the random starts and disturbances.
        processes: Number of processes; 0 for one on each usable core.
        out: Path of the results without ending; by default `acceptance` in the export folder.
    """

    VERB: ClassVar[str] = "accept"

    folder: tyro.conf.Positional[Path]
    demands: Annotated[tuple[Name, ...], NotEmpty()] = get_args(Name)
    trials: Count = 64
    model: Path | None = None
    seconds: Annotated[float, Range(NOMINAL.push_every_s, 3600.0, open_low=True)] = 20.0
    seed: Seed = 0
    processes: Annotated[int, Range(0, 1024)] = 0
    out: Path | None = None


def run(arguments: list[str]) -> None:
    """Examines the export named in `arguments`."""
    options, console = parse_options(Options, arguments, "accept"), Console()
    if options.model is not None and not options.model.is_file():
        raise UserError(f"robot model '{options.model}' does not exist.")
    out = options.out or options.folder / "acceptance"
    json_path, store_path = (out.with_name(out.name + end) for end in (".json", ".trials.json"))
    acceptance = Acceptance(
        contracts.located(options.folder),
        options.demands,
        options.trials,
        options.seconds,
        options.seed,
        options.model,
        store_path,
    )
    check_place(json_path)
    run_trials(console, acceptance.store, acceptance.run, store_path, options.processes)
    report = acceptance.report()
    report["command_line"] = shlex.join(["humoslope", "accept", *arguments])
    write_json(json_path, report)
    console.print(table(report))
    console.print(f"wrote {json_path}", soft_wrap=True)
    if not report["met"]:
        sys.exit(1)
