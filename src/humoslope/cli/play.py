"""`humoslope play DIR`: an exported policy in plain MuJoCo, by its contract alone."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from pathlib import Path
from typing import Annotated, ClassVar

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from humoslope.cli.arguments import parse_options
from humoslope.deploy import contract as contracts
from humoslope.deploy import views
from humoslope.deploy.conditions import NOMINAL, Conditions
from humoslope.deploy.contract import Contract
from humoslope.deploy.gait import FAST_HZ
from humoslope.deploy.player import SETTLE_S, Player, Trial, TrialCfg, run_trials, summarise
from humoslope.deploy.views import Live
from humoslope.errors import UserError
from humoslope.ranges import Checked


@dataclasses.dataclass(frozen=True)
class Options(Checked):
    """Runs an exported policy in plain MuJoCo: live, steered in the browser, in a window or with a gamepad; or
    headless, where it prints how it walks and, at --speed 0, how it stands.

    Straight ahead it begins on level ground, with the ramp in front of it; else it starts on the slope.

    Attributes:
        folder: Folder that `humoslope export` wrote.
        trials: Course, command and number of the trials.
        conditions: Disturbances: robot, sensors, timing and pushes.
        headless: Run without showing anything, as fast as the machine can.
        live: View of the walk, and its controls.
    """

    VERB: ClassVar[str] = "play"

    folder: tyro.conf.Positional[Path]
    trials: Annotated[TrialCfg, tyro.conf.arg(name="")] = dataclasses.field(default_factory=TrialCfg)
    conditions: Annotated[Conditions, tyro.conf.arg(name="")] = NOMINAL
    headless: bool = False
    live: Annotated[Live, tyro.conf.arg(name="")] = dataclasses.field(default_factory=Live)


def run(arguments: list[str]) -> None:
    """Plays the export named in `arguments`."""
    options = parse_options(Options, arguments, "play")
    cfg, console = options.trials, Console()
    if not options.headless and cfg.trials > 1:
        raise UserError("a live walk is one trial; --trials needs --headless.")
    given = {
        "--lateral": cfg.lateral,
        "--yaw-rate": cfg.yaw_rate is not None,
        "--push-m-s": options.conditions.push_m_s,
    }
    if not options.headless and any(given.values()):
        asked = ", ".join(name for name, value in given.items() if value)
        raise UserError(f"a live walk is steered by hand, and nobody pushes it; {asked}: only with --headless.")
    folder = contracts.located(options.folder)
    contract = contracts.read(folder)
    kind = views.chosen(options.live.view)
    if kind is None and not options.headless:
        raise UserError(
            "there is no display; serve a page for a browser with --view browser, or walk without looking with "
            "--headless."
        )
    player = Player(folder, contract, cfg if options.headless else views.long_course(cfg), options.conditions)
    console.print(_introduction(contract, cfg, options.conditions), highlight=False, soft_wrap=True)
    if options.headless or kind is None:
        console.print(_report(_run(console, player), cfg), highlight=False, soft_wrap=True)
        return
    views.show(player, kind, options.live, partial(console.print, highlight=False, markup=False, soft_wrap=True))


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


def _introduction(contract: Contract, cfg: TrialCfg, conditions: Conditions) -> str:
    timing, training, commands = contract.timing, contract.training, contract.commands
    timestep = conditions.timestep_s or timing.physics_step_s
    ground = f"a ramp of {cfg.grade:g} degrees" if cfg.grade else "flat ground"
    if cfg.cross:
        ground = f"a cross slope of {cfg.cross:g} degrees"
    turning = "" if cfg.yaw_rate is None else f" and {cfg.yaw_rate:g} rad/s"
    aside = f", {abs(cfg.lateral):g} m/s to the {'left' if cfg.lateral > 0.0 else 'right'}" if cfg.lateral else ""
    asked = "asked to stand" if cfg.stands else f"{cfg.speed:g} m/s{aside}{turning} asked"
    text = (
        f"[bold]{training.title}[/bold], on {contract.robot.name}\n"
        f"{ground}, friction {cfg.friction:.3g}, {asked}; MuJoCo at "
        f"{timestep * 1e3:g} ms x {round(timing.control_step_s / timestep)}"
    )
    (low, high), (right, left), turns = commands.forward_m_s, commands.left_m_s, commands.yaw_rate_rad_s
    # A range from backward to forward passes through zero, and says nothing about standing.
    within = low <= cfg.speed <= high and right <= cfg.lateral <= left
    within = within and (cfg.yaw_rate is None or turns[0] <= cfg.yaw_rate <= turns[1])
    if commands.trained_to_stand if cfg.stands else within:
        return text
    aside = f" and at {right:g} to {left:g} m/s to the left" if cfg.lateral else ""
    turning = f" and to turn at {turns[0]:g} to {turns[1]:g} rad/s" if cfg.yaw_rate else ""
    stand = ", and not to stand" if cfg.stands else ""
    return f"{text}\n[yellow]It was trained at {low:g} to {high:g} m/s{aside}{turning}{stand}.[/yellow]"


def _report(done: list[Trial], cfg: TrialCfg) -> str:
    result, figures = summarise(done), []
    if cfg.stands:
        measured = f"drift {result.drift:.2f} m"
        figures.append(f"creep {_figure(result.creep, '.3f')} m/s")
    else:
        measured = f"distance {result.distance:.2f} m"
        figures.append(f"{_figure(result.speed, '.3f')} m/s ahead")
        if not cfg.straight:
            figures.append(f"{_figure(result.lateral_speed, '.3f')} m/s to the left")
            figures.append(f"{_figure(result.yaw_rate, '.3f')} rad/s")
    gait = result.gait
    figures += [
        f"{_figure(result.step_rate, '.2f')} steps per second",
        f"both feet down {_figure(gait.double_support, '.0%')} of the time",
        f"knees at {_figure(math.degrees(gait.knee_flexion), '.0f')}°",
        f"parts that touch {_figure(gait.self_contact, '.1%')} of the time",
        f"{_figure(gait.fast_share, '.0%')} of a joint target's variance above {FAST_HZ:g} Hz",
    ]
    measured = f"{measured}; from {SETTLE_S:g} s on {', '.join(figures)}."
    if len(done) == 1:
        ended = f"It fell after {done[0].seconds:.1f} s." if done[0].fell else f"No fall in {done[0].seconds:g} s."
        return f"{ended} {measured[0].upper()}{measured[1:]}"
    falls = result.falls
    return (
        f"Falls {falls.count}/{falls.total}: {100.0 * falls.share:.1f} %, 95 % interval "
        f"{100.0 * falls.low:.1f}-{100.0 * falls.high:.1f} %. Means: {measured}"
    )


def _figure(value: float | None, form: str) -> str:
    return "-" if value is None or math.isnan(value) else f"{value:{form}}"
