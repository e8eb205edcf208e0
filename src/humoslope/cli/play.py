"""`humoslope play DIR`: an exported policy in plain MuJoCo, by its contract alone."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, ClassVar

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from humoslope.cli.arguments import parse_options
from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Contract
from humoslope.deploy.player import SETTLE_S, Player, Trial, TrialCfg, run_trials, summarise
from humoslope.errors import UserError
from humoslope.ranges import Checked


@dataclasses.dataclass(frozen=True)
class Options(Checked):
    """Runs an exported policy in plain MuJoCo, in a window or headless, and prints how it walks; at --speed 0, how it
    stands.

    Attributes:
        folder: Folder that `humoslope export` wrote.
        trials: Course, command and number of the trials.
        headless: Run without a window, as fast as the machine can.
    """

    VERB: ClassVar[str] = "play"

    folder: tyro.conf.Positional[Path]
    trials: Annotated[TrialCfg, tyro.conf.arg(name="")] = dataclasses.field(default_factory=TrialCfg)
    headless: bool = False


def run(arguments: list[str]) -> None:
    """Plays the export named in `arguments`."""
    options = parse_options(Options, arguments, "play")
    cfg, console = options.trials, Console()
    if not options.headless and cfg.trials > 1:
        raise UserError("a window shows one trial; --trials needs --headless.")
    contract = contracts.read(options.folder)
    player = Player(options.folder, contract, cfg)
    if options.headless:
        console.print(_introduction(contract, cfg), highlight=False, soft_wrap=True)
        console.print(_report(_run(console, player), cfg), highlight=False, soft_wrap=True)
        return
    from humoslope.deploy import window  # needs libraries that a machine without a display may lack

    window.check_display()
    console.print(_introduction(contract, cfg), window.KEYS, sep="\n", highlight=False, soft_wrap=True)
    window.live(player, console.print)


def _run(console: Console, player: Player) -> list[Trial]:
    done: list[Trial] = []
    columns = (
        TextColumn("running"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[speed]}, left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        bar = progress.add_task("", total=player.cfg.trials, speed="-")
        for trial in run_trials(player):
            done.append(trial)
            elapsed = progress.tasks[0].elapsed or 1.0
            progress.update(bar, advance=1, speed=f"{sum(t.seconds for t in done) / elapsed:.0f} x real time")
    return done


def _introduction(contract: Contract, cfg: TrialCfg) -> str:
    timing, training, commands = contract.timing, contract.training, contract.commands
    ground = f"a ramp of {cfg.grade:g} degrees" if cfg.grade else "flat ground"
    if cfg.cross:
        ground = f"a cross slope of {cfg.cross:g} degrees"
    turning = "" if cfg.yaw_rate is None else f" and {cfg.yaw_rate:g} rad/s"
    asked = f"{cfg.speed:g} m/s{turning} asked" if cfg.speed or turning else "asked to stand"
    text = (
        f"[bold]{training.task}[/bold], iteration {training.iteration}, on {contract.robot.name}\n"
        f"{ground}, friction {cfg.friction:.3g}, {asked}; MuJoCo at "
        f"{timing.physics_step_s * 1e3:g} ms x {contract.decimation}"
    )
    low, high = commands.forward_m_s
    stands = cfg.speed == 0.0 and not cfg.yaw_rate
    # A range from backward to forward passes through zero, and says nothing about standing.
    if commands.trained_to_stand if stands else low <= cfg.speed <= high:
        return text
    stand = ", and not to stand" if stands else ""
    return f"{text}\n[yellow]It was trained at {low:g} to {high:g} m/s{stand}.[/yellow]"


def _report(done: list[Trial], cfg: TrialCfg) -> str:
    result = summarise(done)
    if cfg.speed:
        speed = "-" if result.speed is None else f"{result.speed:.3f} m/s"
        measured = f"distance {result.distance:.2f} m, speed from {SETTLE_S:g} s on {speed}."
    else:
        creep = "-" if result.creep is None else f"{result.creep:.3f} m/s"
        rate = "-" if result.step_rate is None else f"{result.step_rate:.2f}"
        measured = f"drift {result.drift:.2f} m; from {SETTLE_S:g} s on creep {creep}, {rate} steps per second."
    if len(done) == 1:
        ended = f"It fell after {done[0].seconds:.1f} s." if done[0].fell else f"No fall in {done[0].seconds:g} s."
        return f"{ended} {measured[0].upper()}{measured[1:]}"
    falls = result.falls
    return (
        f"Falls {falls.count}/{falls.total}: {100.0 * falls.share:.1f} %, 95 % interval "
        f"{100.0 * falls.low:.1f}-{100.0 * falls.high:.1f} %. Means: {measured}"
    )
