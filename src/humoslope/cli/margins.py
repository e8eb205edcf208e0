"""`humoslope margins DIR`: the physical conditions up to which an exported policy succeeds."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, get_args

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from humoslope.cpu import usable_cores
from humoslope.deploy.conditions import NOMINAL
from humoslope.deploy.player import TrialCfg
from humoslope.errors import UserError
from humoslope.evaluation.margins import show
from humoslope.evaluation.margins.quantities import Name, Success
from humoslope.evaluation.margins.run import Certificate
from humoslope.evaluation.margins.search import Rule
from humoslope.extras import MATPLOTLIB, installed, missing
from humoslope.files import check_place
from humoslope.interrupts import Terminated, deferred_interrupts
from humoslope.seal import write_json


@dataclasses.dataclass(frozen=True)
class Options:
    """Searches for the physical conditions up to which an exported policy succeeds, in plain MuJoCo.

    One quantity at a time is varied from its nominal value to one at which no policy is expected to succeed. Finished
    trials are kept, so that the same command continues after an interruption.

    Attributes:
        folder: Folder that `humoslope export` wrote.
        quantities: Names of the quantities to vary.
        rule: Rule by which a value is judged.
        success: Definition of a successful trial.
        model: MJCF of another robot with joints of the same names, to examine the policy on instead of its own model.
        speed: Commanded forward speed, m/s.
        grade: Grade of the course, degrees; turning and cross slopes are examined on ground without it.
        seconds: Length of a trial, s.
        seed: Seed of the random starts and disturbances.
        processes: Number of processes; 0 for one on each usable core.
        out: Path of the results without ending; by default `margins` in the export folder.
    """

    folder: tyro.conf.Positional[Path]
    quantities: tuple[Name, ...] = get_args(Name)
    rule: Annotated[Rule, tyro.conf.arg(name="")] = dataclasses.field(default_factory=Rule)
    success: Annotated[Success, tyro.conf.arg(name="")] = dataclasses.field(default_factory=Success)
    model: Path | None = None
    speed: float = 0.5
    grade: float = 0.0
    seconds: float = 20.0
    seed: int = 0
    processes: int = 0
    out: Path | None = None

    def __post_init__(self) -> None:
        if self.speed <= 0.0:
            raise UserError(f"--speed {self.speed:g} must be positive; margins are those of a walk.")
        if self.seconds <= 2.0:
            raise UserError(f"--seconds {self.seconds:g} must be above 2; speed is measured from 2 s on.")
        if "push" in self.quantities and self.seconds <= NOMINAL.push_every_s:
            raise UserError(
                f"--seconds {self.seconds:g} must be above {NOMINAL.push_every_s:g}, when the first push comes."
            )
        if self.processes < 0 or not self.quantities:
            raise UserError(f"--processes {self.processes} must be 0 or more, and --quantities must name some.")


def run(arguments: list[str]) -> None:
    """Examines the export named in `arguments`."""
    options, console = tyro.cli(Options, args=arguments, prog="humoslope margins"), Console()
    if options.model is not None and not options.model.is_file():
        raise UserError(f"robot model '{options.model}' does not exist.")
    out = options.out or options.folder / "margins"
    json_path, store_path, figure_path = (out.with_name(out.name + end) for end in (".json", ".trials.json", ".png"))
    nominal = TrialCfg(grade=options.grade, speed=options.speed, seconds=options.seconds, seed=options.seed)
    certificate = Certificate(
        options.folder, nominal, options.quantities, options.rule, options.success, options.model, store_path
    )
    check_place(json_path)
    if len(certificate.store):
        console.print(f"continues with {len(certificate.store)} trials that were finished before")
    with deferred_interrupts() as interrupt, trials_progress(console) as update:
        finished = certificate.run(interrupt, options.processes or usable_cores(), update)
    if not finished:
        console.print(f"Finished trials are kept in {store_path}; the same command continues.", soft_wrap=True)
        raise Terminated(interrupt.number)
    report = certificate.report()
    report["command_line"] = shlex.join(["humoslope", "margins", *arguments])
    write_json(json_path, report)
    console.print(show.table(report))
    if installed(MATPLOTLIB):
        show.draw(report, figure_path)
        console.print(f"wrote {json_path} and {figure_path}", soft_wrap=True)
    else:
        console.print(f"wrote {json_path}\n{missing('its picture', MATPLOTLIB)}", soft_wrap=True)


@contextmanager
def trials_progress(console: Console) -> Iterator[Callable[[int, int], None]]:
    """Shows a bar of trials; yields a function that takes the numbers of trials done and left."""
    columns = (TextColumn("trials"), BarColumn(), MofNCompleteColumn(), TextColumn("left"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task("", total=None)
        yield lambda done, left: progress.update(bar, completed=done, total=done + left)
