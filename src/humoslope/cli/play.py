"""`humoslope play DIR`: an exported policy in plain MuJoCo, by its contract alone."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract
from humoslope.deploy.player import SETTLE_S, Course, Player, Walk, outcome, walks
from humoslope.errors import UserError


@dataclasses.dataclass(frozen=True)
class Options:
    """Lets an exported policy walk in plain MuJoCo, in a window or without one, and says how it went.

    Attributes:
        folder: Path of a folder of `humoslope export`.
        course: Settings of the walk.
        headless: Walk without a window, as fast as the machine can.
    """

    folder: tyro.conf.Positional[Path]
    course: Annotated[Course, tyro.conf.arg(name="")] = dataclasses.field(default_factory=Course)
    headless: bool = False


def run(arguments: list[str]) -> None:
    """Plays the export named in `arguments`."""
    options = tyro.cli(Options, args=arguments, prog="humoslope play")
    course, console = options.course, Console()
    if not options.headless and course.trials > 1:
        raise UserError("a window shows one walk; --trials needs --headless.")
    contract = contracts.read(options.folder)
    player = Player(options.folder, contract, course)
    if options.headless:
        console.print(_introduction(contract, course), highlight=False, soft_wrap=True)
        console.print(_report(_walk(console, player)), highlight=False, soft_wrap=True)
        return
    from humoslope.deploy import window  # needs libraries that a machine without a display may lack

    window.check_display()
    console.print(_introduction(contract, course), window.KEYS, sep="\n", highlight=False, soft_wrap=True)
    window.live(player, console.print)


def _walk(console: Console, player: Player) -> list[Walk]:
    done: list[Walk] = []
    columns = (
        TextColumn("walking"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[speed]}, left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task("", total=player.course.trials, speed="-")
        for walk in walks(player):
            done.append(walk)
            elapsed = progress.tasks[0].elapsed or 1.0
            progress.update(bar, advance=1, speed=f"{sum(w.seconds for w in done) / elapsed:.0f} x real time")
    return done


def _introduction(contract: Contract, course: Course) -> str:
    timing, training, commands = contract.timing, contract.training, contract.commands
    ground = f"a ramp of {course.grade:g} degrees" if course.grade else "flat ground"
    text = (
        f"[bold]{training.task}[/bold], iteration {training.iteration}, on {contract.robot.name}\n"
        f"{ground}, friction {course.friction:.3g}, {course.speed:g} m/s asked; MuJoCo at "
        f"{timing.physics_step_s * 1e3:g} ms x {contract.decimation}"
    )
    low, high = commands.forward_m_s
    trained = low <= course.speed <= high or (commands.stands and course.speed == 0.0)
    return text if trained else f"{text}\n[yellow]It was trained at {low:g} to {high:g} m/s.[/yellow]"


def _report(done: list[Walk]) -> str:
    result = outcome(done)
    speed = "-" if result.speed is None else f"{result.speed:.3f} m/s"
    if len(done) == 1:
        ended = f"It fell after {done[0].seconds:.1f} s." if done[0].fell else f"No fall in {done[0].seconds:g} s."
        return f"{ended} Way {result.distance:.2f} m, mean speed from {SETTLE_S:g} s on {speed}."
    falls = result.falls
    return (
        f"Falls {falls.count}/{falls.total}: {100.0 * falls.share:.1f} %, 95 % interval "
        f"{100.0 * falls.low:.1f}-{100.0 * falls.high:.1f} %. "
        f"Mean way {result.distance:.2f} m, mean speed from {SETTLE_S:g} s on {speed}."
    )
