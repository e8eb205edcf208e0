"""`humoslope dashboard [RUN]`: the curves of a training in the terminal, as they grow."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path

import tyro
from rich.console import Console
from rich.live import Live

from humoslope.errors import require_positive
from humoslope.evaluation.report.dashboard import CurveFollower, find_newest, view


@dataclasses.dataclass(frozen=True)
class Options:
    """Shows progress, reward, falls, speed, harness and terrain level of a training in the terminal, until Ctrl-C.

    It reads the run's event files and disturbs nothing; the training may run in another terminal or be long over.

    Attributes:
        run: Path of a run folder; by default the one under logs/ whose curves were written last.
        once: Show the present state once. So it is, too, where the output is no terminal.
        every: Time between two looks at the run, s.
    """

    run: tyro.conf.Positional[Path | None] = None
    once: bool = False
    every: float = 5.0


def run(arguments: list[str]) -> None:
    """Shows the run named in `arguments`."""
    options = tyro.cli(Options, args=arguments, prog="humoslope dashboard")
    require_positive("dashboard", every=options.every)
    console = Console()
    run_dir = options.run or find_newest()
    follower = CurveFollower(run_dir)
    first = view(run_dir, follower.read(), console.width)
    if options.once or not console.is_terminal:
        console.print(first)
        return
    with Live(first, console=console, screen=True, auto_refresh=False) as live:
        while True:
            live.refresh()
            time.sleep(options.every)
            live.update(view(run_dir, follower.read(), console.width))
