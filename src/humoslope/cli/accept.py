"""`humoslope accept DIR`: whether an exported policy meets what an owner of the robot would demand."""

from __future__ import annotations

import dataclasses
import shlex
import sys
from pathlib import Path
from typing import get_args

import tyro
from rich.console import Console

from humoslope.cli.margins import trials_progress
from humoslope.cpu import usable_cores
from humoslope.deploy.conditions import NOMINAL
from humoslope.errors import UserError
from humoslope.evaluation.margins.acceptance import Acceptance, table
from humoslope.evaluation.margins.demands import Name
from humoslope.files import check_place
from humoslope.interrupts import Terminated, deferred_interrupts
from humoslope.seal import write_json


@dataclasses.dataclass(frozen=True)
class Options:
    """Checks in plain MuJoCo whether an exported policy meets what is demanded of one that is to walk on a robot:
    standing still, all directions, slopes across, pushes, delays, other physics steps, a calm and upright gait.

    Finished trials are kept, so that the same command continues after an interruption. The exit code is 1 if a demand
    is not met.

    Attributes:
        folder: Folder that `humoslope export` wrote.
        demands: Names of the demands to check.
        trials: Trials of each case.
        model: MJCF of another robot with joints of the same names, to examine the policy on instead of its own model.
        seconds: Length of a trial, s.
        seed: Seed of the random starts and disturbances.
        processes: Number of processes; 0 for one on each usable core.
        out: Path of the results without ending; by default `acceptance` in the export folder.
    """

    folder: tyro.conf.Positional[Path]
    demands: tuple[Name, ...] = get_args(Name)
    trials: int = 64
    model: Path | None = None
    seconds: float = 20.0
    seed: int = 0
    processes: int = 0
    out: Path | None = None

    def __post_init__(self) -> None:
        if self.trials < 1 or self.seed < 0 or self.processes < 0:
            raise UserError(
                f"--trials {self.trials} must be at least 1, and --seed {self.seed} and --processes {self.processes} "
                "0 or more."
            )
        if not NOMINAL.push_every_s < self.seconds <= 3600.0:
            raise UserError(
                f"--seconds {self.seconds:g} must be above {NOMINAL.push_every_s:g}, when the first push comes, and at "
                "most 3600."
            )
        if not self.demands:
            raise UserError("--demands must name some.")


def run(arguments: list[str]) -> None:
    """Examines the export named in `arguments`."""
    options, console = tyro.cli(Options, args=arguments, prog="humoslope accept"), Console()
    if options.model is not None and not options.model.is_file():
        raise UserError(f"robot model '{options.model}' does not exist.")
    out = options.out or options.folder / "acceptance"
    json_path, store_path = (out.with_name(out.name + end) for end in (".json", ".trials.json"))
    acceptance = Acceptance(
        options.folder,
        options.demands,
        options.trials,
        options.seconds,
        options.seed,
        options.model,
        store_path,
    )
    check_place(json_path)
    if len(acceptance.store):
        console.print(f"continues with {len(acceptance.store)} trials that were finished before")
    with deferred_interrupts() as interrupt, trials_progress(console) as update:
        finished = acceptance.run(interrupt, options.processes or usable_cores(), update)
    if not finished:
        console.print(f"Finished trials are kept in {store_path}; the same command continues.", soft_wrap=True)
        raise Terminated(interrupt.number)
    report = acceptance.report()
    report["command_line"] = shlex.join(["humoslope", "accept", *arguments])
    write_json(json_path, report)
    console.print(table(report))
    console.print(f"wrote {json_path}", soft_wrap=True)
    if not report["met"]:
        sys.exit(1)
