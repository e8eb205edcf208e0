"""`humoslope margins DIR`: the physical conditions up to which an exported policy succeeds."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, ClassVar, get_args

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from humoslope.cli.arguments import parse_options
from humoslope.cpu import usable_cores
from humoslope.deploy import contract as contracts
from humoslope.deploy.conditions import NOMINAL
from humoslope.deploy.player import SETTLE_S, Slope, TrialCfg
from humoslope.errors import UserError
from humoslope.evaluation.margins import show
from humoslope.evaluation.margins.quantities import Name, Success
from humoslope.evaluation.margins.run import Certificate
from humoslope.evaluation.margins.search import Rule
from humoslope.evaluation.margins.trials import TrialStore
from humoslope.extras import MATPLOTLIB, installed, missing
from humoslope.files import check_place
from humoslope.interrupts import Interrupt, Terminated, deferred_interrupts
from humoslope.ranges import Checked, NotEmpty, Positive, Range, Seed
from humoslope.seal import write_json


@dataclasses.dataclass(frozen=True)
class Options(Checked):
    """Searches for the physical conditions up to which an exported policy succeeds, in plain MuJoCo.

    One quantity at a time is varied from a mild value to one at which no policy is expected to succeed. Finished
    trials are kept, so that the same command continues after an interruption.

    Attributes:
        folder: Folder that `humoslope export` wrote.
        quantities: Names of the quantities to vary.
        rule: Rule by which a value is judged.
        success: Definition of a successful trial.
        model: MJCF of another robot with joints of the same names, to examine the policy on instead of its own model.
        speed: Commanded forward speed, m/s.
        grade: Grade of the course, degrees; turning and cross slopes are examined on ground without it.
        seconds: Length of a trial, s; speed is measured from 2 s on.
        seed: Seed of the random starts and disturbances.
        processes: Number of processes; 0 for one on each usable core.
        out: Path of the results without ending; by default `margins` in the export folder.
    """

    VERB: ClassVar[str] = "margins"

    folder: tyro.conf.Positional[Path]
    quantities: Annotated[tuple[Name, ...], NotEmpty()] = get_args(Name)
    rule: Annotated[Rule, tyro.conf.arg(name="")] = dataclasses.field(default_factory=Rule)
    success: Annotated[Success, tyro.conf.arg(name="")] = dataclasses.field(default_factory=Success)
    model: Path | None = None
    speed: Positive = 0.5
    grade: Slope = 0.0
    seconds: Annotated[float, Range(SETTLE_S, open_low=True)] = 20.0
    seed: Seed = 0
    processes: Annotated[int, Range(0, 1024)] = 0
    out: Path | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if "push" in self.quantities and self.seconds <= NOMINAL.push_every_s:
            raise UserError(
                f"--seconds {self.seconds:g} must be above {NOMINAL.push_every_s:g}, when the first push comes."
            )


def run(arguments: list[str]) -> None:
    """Examines the export named in `arguments`."""
    options, console = parse_options(Options, arguments, "margins"), Console()
    if options.model is not None and not options.model.is_file():
        raise UserError(f"robot model '{options.model}' does not exist.")
    out = options.out or options.folder / "margins"
    json_path, store_path, figure_path = (out.with_name(out.name + end) for end in (".json", ".trials.json", ".png"))
    nominal = TrialCfg(grade=options.grade, speed=options.speed, seconds=options.seconds, seed=options.seed)
    certificate = Certificate(
        contracts.located(options.folder),
        nominal,
        options.quantities,
        options.rule,
        options.success,
        options.model,
        store_path,
    )
    check_place(json_path)
    run_trials(console, certificate.store, certificate.run, store_path, options.processes)
    report = certificate.report()
    report["command_line"] = shlex.join(["humoslope", "margins", *arguments])
    write_json(json_path, report)
    console.print(show.table(report))
    if installed(MATPLOTLIB):
        show.draw(report, figure_path)
        console.print(f"wrote {json_path} and {figure_path}", soft_wrap=True)
    else:
        console.print(f"wrote {json_path}\n{missing('its picture', MATPLOTLIB)}", soft_wrap=True)


def run_trials(
    console: Console,
    store: TrialStore,
    run: Callable[[Interrupt, int, Callable[[int, int], object]], bool],
    store_path: Path,
    processes: int,
) -> None:
    """Runs the trials that are missing, with a bar of them.

    Args:
        store: Finished trials.
        run: `Certificate.run` or `Acceptance.run`.
        store_path: File of the finished trials.
        processes: Number of processes; 0 for one on each usable core.

    Raises:
        Terminated: If it was interrupted.
    """
    if len(store):
        console.print(f"continues with {len(store)} trials that were finished before")
    columns = (TextColumn("trials"), BarColumn(), MofNCompleteColumn(), TextColumn("left"), TimeRemainingColumn())
    with deferred_interrupts() as interrupt, Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task("", total=None)
        finished = run(
            interrupt,
            processes or usable_cores(),
            lambda done, left: progress.update(bar, completed=done, total=done + left),
        )
    if not finished:
        console.print(f"Finished trials are kept in {store_path}; the same command continues.", soft_wrap=True)
        raise Terminated(interrupt.number)
