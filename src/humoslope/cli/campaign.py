"""`humoslope campaign FILE`: a table of trainings and evaluations, one after the other or several at once."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from itertools import takewhile
from pathlib import Path
from typing import TypeVar

import tyro
from rich.console import Console

from humoslope.campaign import disk
from humoslope.campaign import run as queue
from humoslope.campaign.file import Evaluation, read_campaign
from humoslope.campaign.plan import Plan, Scale, make_plan
from humoslope.campaign.run import Run
from humoslope.campaign.show import Board, dry_run
from humoslope.cli.options import parse
from humoslope.cli.train import TrainArgs
from humoslope.cpu import usable_cores
from humoslope.errors import UserError, require_not_negative
from humoslope.interrupts import Terminated
from humoslope.presets import Preset, apply_preset, resolve_preset
from humoslope.ranges import check_config
from humoslope.registry import build_task, load_content

R = TypeVar("R")


@dataclasses.dataclass(frozen=True)
class Options:
    """Runs the trainings and evaluations that a file lists, such as experiments/table2.toml.

    Everything is written into one folder, and what is there is not done again: the same command goes on after any
    interruption, on any machine that has the folder. A job that fails does not stop the others; those are named at the
    end, and the exit code is 2.

    Attributes:
        file: Path of the campaign file.
        out: Path of the folder; by default logs/ with the name of the file.
        jobs: Number of trainings or evaluations that run at once.
        threads: Number of threads of each; 0 for an equal share of the CPUs.
        dry_run: Print what is left to do and what it costs, and do nothing.
        speed: Environment steps per second of a training, for the time left; 0 for what was measured in the folder.
        pack: Path of a folder for what is finished, small enough to be committed: actors, curves, results. Nothing is
            run then.
    """

    file: tyro.conf.Positional[Path]
    out: Path | None = None
    jobs: int = 1
    threads: int = 0
    dry_run: bool = False
    speed: float = 0.0
    pack: Path | None = None


def run(arguments: list[str]) -> None:
    """Runs the campaign named in `arguments`."""
    options = tyro.cli(Options, args=arguments, prog="humoslope campaign")
    if options.jobs < 1 or options.threads < 0:
        raise UserError("campaign: --jobs must be 1 or more, and --threads 0 or more.")
    if options.dry_run and options.pack is not None:
        raise UserError(
            "campaign: --dry-run says what there is to do, and --pack writes what is done; give one of them."
        )
    require_not_negative("campaign", speed=options.speed)
    campaign = read_campaign(options.file)
    load_content()
    folder = options.out or Path("logs") / options.file.stem
    plan = make_plan(disk.settled(campaign, folder), folder, scale_of, walk_of)
    disk.check_begun(plan)
    console = Console()
    if options.pack is not None:
        from humoslope.campaign.pack import pack

        written = pack(plan, options.pack)
        console.print(f"packed {len(written)} files into {options.pack}", soft_wrap=True, highlight=False)
    elif options.dry_run:
        console.print(dry_run(Run(plan), options.speed, options.jobs))
    else:
        _run(plan, options, console)


def _run(plan: Plan, options: Options, console: Console) -> None:
    threads = options.threads or max(1, usable_cores() // options.jobs)
    with disk.held(plan.folder):
        disk.leave_file(plan, plan.folder)
        state = Run(plan)
        each = f"{threads} thread{'s' * (threads > 1)}"
        console.print(f"{plan.folder}: {options.jobs} at once, {each} each", soft_wrap=True, highlight=False)
        with Board(state, console, options.jobs, options.speed) as board:
            stopped = queue.run(state, options.jobs, threads, board.show, queue.launch)
    for name, reason in state.reasons.items():
        console.print(f"{state.states[name]}: {name}: {reason}", soft_wrap=True, highlight=False, markup=False)
    if stopped:
        raise Terminated(stopped)
    if state.reasons:
        failed, barred = state.count("failed"), state.count("barred")
        hindered = f", and {barred} need their results" if barred else ""
        raise UserError(f"{failed} of {len(plan.jobs)} jobs failed{hindered}; the same command tries them again.")


def scale_of(task: str, preset: Preset, options: Sequence[str]) -> Scale:
    """Scale of a task with options.

    Raises:
        UserError: If the task or an option does not exist, or a value is impossible.
    """
    cfg, chosen = build_task(task), resolve_preset(preset)
    if options:
        cfg, _ = _quietly(lambda: parse(TrainArgs(), task, ["--preset", preset, *options]))
    else:
        apply_preset(cfg, chosen)  # as `parse` does, in a fraction of its time
    cfg.agent.check()
    check_config("env", cfg.env)
    return Scale(
        num_envs=cfg.env.num_envs,
        samples=cfg.env.num_envs * cfg.agent.num_steps_per_env,
        save_interval=cfg.agent.save_interval,
        preset=chosen,
        start=cfg.start.task if cfg.start else "",
        calibrated=cfg.start.calibrated if cfg.start else "",
    )


def walk_of(evaluation: Evaluation) -> int:
    """Environment steps of an evaluation in which every trial succeeds at the commanded speed.

    Raises:
        UserError: If its options are impossible.
    """
    # Their modules are needed here alone, and take long to load.
    from humoslope.cli import evaluate, ramps
    from humoslope.evaluation.report.results import TrialSetup

    words = ["model.pt", *evaluation.words]
    if evaluation.kind == "ramps":
        protocol = _quietly(lambda: tyro.cli(ramps.Options, args=words)).protocol
        return round(protocol.starts * len(protocol.grades) * protocol.seconds / CONTROL_S)
    track = _quietly(lambda: evaluate.read_options(words)).protocol
    setup = TrialSetup(track.speed, track.start_place, track.success_place, track.find_course().segments)
    seconds = sum(min(track.timeout_s, setup.commanded_seconds(grade)) for grade in track.grades)
    return round(seconds * len(track.tiers) * track.trials / CONTROL_S)


CONTROL_S = 0.02
"""Control step of the tasks, s."""


def _quietly(read: Callable[[], R]) -> R:
    """What `read` returns; the box in which tyro tells of a mistake becomes one sentence."""
    said = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")  # of which it knows that a frame can be drawn in it
    try:
        with redirect_stdout(said), redirect_stderr(said):
            return read()
    except SystemExit:
        said.seek(0)
        lines = [line.strip().strip("│").strip() for line in said if line[:1] not in ("╭", "╰")]
        sentence = takewhile(lambda line: set(line) != {"─"}, lines)  # up to the first rule
        raise UserError(f"{' '.join(' '.join(sentence).split()).rstrip('.')}.") from None
