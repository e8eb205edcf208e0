"""`humoslope evaluate CHECKPOINT ...`: the held-out benchmark, and the slope-limit sweep."""

from __future__ import annotations

import dataclasses
import shlex
from pathlib import Path
from typing import Annotated, ClassVar

import tyro
from rich.console import Console

from humoslope.cli.arguments import parse_options
from humoslope.cli.measure import subject
from humoslope.errors import UserError
from humoslope.evaluation.track.protocol import HeldOutProtocol, sweep_protocol
from humoslope.evaluation.track.run import Plan, evaluate
from humoslope.interrupts import Terminated
from humoslope.ranges import Checked, Count


@dataclasses.dataclass(frozen=True)
class Kind(Checked):
    """The choice that the other options take their defaults from.

    Attributes:
        sweep: Search for the steepest grade that is mastered instead: every degree from 10 to 40 at the middle
            friction.
    """

    VERB: ClassVar[str] = "evaluate"

    sweep: bool = False


@dataclasses.dataclass(frozen=True)
class Options(Kind):
    """Lets a trained policy walk the held-out track at every grade and friction, and writes the paper's figures of it.

    With several checkpoints of one method their trials are pooled. Finished trials are kept: an evaluation that was
    interrupted continues when the same command is given again, and one with more --trials builds on one with fewer.

    Attributes:
        checkpoints: Checkpoints of one method; a run folder stands for its newest one. Export folders are taken as
            well, also of imported policies.
        protocol: Settings of the benchmark.
        out: Path of the results without ending; by default beside the first checkpoint, or in the export folder.
        parallel_trials: Number of trials of a cell that run side by side.
        fresh: Walk all trials again and ignore those that were saved before.
    """

    checkpoints: tyro.conf.Positional[tuple[Path, ...]] = ()
    protocol: Annotated[HeldOutProtocol, tyro.conf.arg(name="")] = dataclasses.field(default_factory=HeldOutProtocol)
    out: Path | None = None
    parallel_trials: Count = 32
    fresh: bool = False


def run(arguments: list[str]) -> None:
    """Evaluates the checkpoints named in `arguments`."""
    options = read_options(arguments)
    if not options.checkpoints:
        raise UserError("evaluate needs a checkpoint, such as logs/.../model_1000.pt.")
    plan = Plan(
        options.protocol,
        options.sweep,
        options.parallel_trials,
        options.fresh,
        options.out,
        shlex.join(["humoslope", "evaluate", *arguments]),
    )
    if stopped_by := evaluate([subject(path) for path in options.checkpoints], plan, Console()):
        raise Terminated(stopped_by)


def read_options(arguments: list[str]) -> Options:
    """The options in `arguments`; those that are not there have the defaults of the kind of evaluation."""
    kind, _ = tyro.cli(Kind, args=arguments, add_help=False, return_unknown_args=True)
    default = Options(protocol=sweep_protocol() if kind.sweep else HeldOutProtocol())
    return parse_options(Options, arguments, "evaluate", default)
