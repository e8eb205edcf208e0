"""`humoslope train TASK`: trains in a run folder, and resumes."""

from __future__ import annotations

import dataclasses
from contextlib import ExitStack, nullcontext
from functools import partial
from pathlib import Path

import torch
from rich.console import Console

from humoslope.cli.options import configuration_of, early, named_task, parse
from humoslope.cli.warm_start import Origin, find_origin
from humoslope.cpu import thread_advice, usable_cores
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.interrupts import Terminated
from humoslope.learning import checkpoint
from humoslope.learning.configuration import departures, trained_cfg
from humoslope.learning.distributed import choose_device, process_group, read_processes, wait_for_all
from humoslope.learning.policy import spec_of
from humoslope.learning.rng import seed_everything
from humoslope.learning.run_folder import LOOKING, claimed, find_run, record_start, tee
from humoslope.learning.trainer import Trainer
from humoslope.learning.videos import IntervalVideos
from humoslope.presets import Preset
from humoslope.registry import TaskCfg, build_task
from humoslope.words import merge_options, option_groups

ONCE = ("--resume", "--run-dir", "--init", "--calibration", *LOOKING)
"""Options of a single start, which are not recorded as options of the run."""


@dataclasses.dataclass(frozen=True)
class TrainArgs:
    """Trains a task in a run folder, or continues a run. A training that a signal has stopped has saved its state, and
    ends with exit code 128 + the signal's number (Ctrl-C 130, SIGTERM 143, SIGHUP 129); 0 means complete.

    Attributes:
        preset: Scale of the training; "auto" for the one that fits the machine.
        resume: Path of a run folder whose last checkpoint is continued with the options that it was started with;
            "latest" for the newest run of the task.
        run_dir: Path of the folder of a new run; by default logs/TASK/TIME.
        init: Path of a checkpoint, or of a run folder for its newest one, whose actor the new run starts with. A task
            that continues another one finds it by itself.
        calibration: Path of a swing calibration, or "prior" for the values in the task's configuration; by default the
            calibration beside the checkpoint that the run starts from.
        watch: Show a few robots live in a browser on this machine. While nobody looks, nothing is sent.
        watch_worlds: Number of robots that are shown, spread over the columns of the terrain.
        web_port: TCP port of the web page.
        port: TCP port that training sends to and the web page reads from.
        video_every: Number of iterations between two videos in the run folder, drawn at low priority while training
            goes on; 0 for none.
    """

    preset: Preset = "auto"
    resume: str = ""
    run_dir: str = ""
    init: str = ""
    calibration: str = ""
    watch: bool = False
    watch_worlds: int = 4
    web_port: int = 9090
    port: int = 9877
    video_every: int = 0


def run(arguments: list[str]) -> None:
    """Trains the task named first in `arguments`."""
    named = named_task("train", arguments)
    if named is None:
        return
    task, options = named
    earlier = build_task(task).start  # a typing mistake in the name is said before anything else

    if {"-h", "--help"} & set(options):
        parse(TrainArgs(), task, options)  # prints the options and exits, whatever the run would start from

    own = early(TrainArgs(), task, options)
    resumed = find_run(task, own.resume) if own.resume else None
    if resumed is None:
        origin = find_origin(earlier, own.init, own.calibration)
        options = merge_options([*origin.options], options)  # what the user typed wins
        cfg, args = parse(TrainArgs(), task, options)
        # A resumed run keeps its scale on any machine.
        options = merge_options(options, ["--preset", args.preset], without=ONCE)
        _train(task, cfg, options, None, Path(args.run_dir) if args.run_dir else None, origin, args)
        return
    start = checkpoint.latest(resumed)
    base = _resumed_cfg(start, task)
    _require_effect(options, base)
    cfg, args = parse(TrainArgs(), task, options, base=base)
    _train(task, cfg, merge_options(options, [], without=ONCE), start, resumed, Origin(), args)


def _train(
    task: str,
    cfg: TaskCfg,
    options: list[str],
    resumed: Path | None,
    run_dir: Path | None,
    origin: Origin,
    args: TrainArgs,
) -> None:
    processes = read_processes()
    # What can be wrong is said before anything is written, and as far as possible before anything is built.
    _check_looking(args)
    cfg.agent.check()
    device = choose_device(cfg.env.sim.device, cfg.env.sim.backend, processes)
    # Every process draws its own randomness, on a device of its own; the checkpoint keeps what was asked for.
    own = dataclasses.replace(
        cfg.env, seed=cfg.env.seed + processes.rank, sim=dataclasses.replace(cfg.env.sim, device=device)
    )
    seed_everything(own.seed)
    with ExitStack() as stack:
        claim = claimed(run_dir, task, new=resumed is None) if processes.is_first else nullcontext()
        run_dir = stack.enter_context(claim)
        env = ManagerBasedRlEnv(own)
        stack.enter_context(process_group(processes, str(env.device)))
        console = stack.enter_context(tee(None if run_dir is None else run_dir / "console.log"))
        trainer = Trainer(task, cfg, env, run_dir, console, processes)
        how = ""
        if resumed is not None:
            how = trainer.resume(resumed)
        elif origin.parent is not None:
            trainer.warm_start(origin.parent.path)
        if run_dir is not None:
            source = origin.parent.path if origin.parent is not None else resumed
            record = partial(record_start, run_dir, task, cfg, options, trainer.iteration, trainer.total_steps, source)
            record()
            trainer.on_lost_folder = record
            _introduce(console, task, env, run_dir)
            if resumed is not None:
                console.print(f"Resumed from {resumed}. {how}", soft_wrap=True, highlight=False)
            _introduce_origin(console, cfg, origin)
            if env.device.type == "cpu" and (advice := thread_advice()):
                console.print(f"[yellow]{advice}[/yellow]", soft_wrap=True)
        if run_dir is not None:
            _let_look(stack, console, trainer, run_dir, args)
        if not trainer.train():
            # A launcher of several processes ends all as soon as one ends with another code than 0.
            wait_for_all(env.device)
            raise Terminated(trainer.stopped_by)


def _check_looking(args: TrainArgs) -> None:
    if args.video_every < 0:
        raise UserError(f"--video-every is {args.video_every}; it must be 0 or more.")
    if args.watch:
        if args.watch_worlds < 1:
            raise UserError(f"--watch-worlds is {args.watch_worlds}; it must be at least 1.")
        from humoslope.replay.rerun.viewer import check_ports

        check_ports(args.web_port, args.port)


def _let_look(stack: ExitStack, console: Console, trainer: Trainer, run_dir: Path, args: TrainArgs) -> None:
    """Lets those look on whom the user asked for."""
    if args.video_every:
        trainer.onlookers.append(IntervalVideos(run_dir, args.video_every, trainer.save, console))
    if args.watch:
        from humoslope.replay.rerun.live import live_view  # loads the viewer, which takes a while

        title = f"{trainer.task}, {run_dir.name}"
        view = live_view(trainer.env, args.watch_worlds, args.web_port, args.port, title)
        live, address = stack.enter_context(view)
        trainer.onlookers.append(live)
        console.print(f"Live view: {address}", soft_wrap=True, highlight=False)


def _resumed_cfg(start: Path, task: str) -> TaskCfg:
    """The configuration that a run goes on with: that of its checkpoint."""
    state = checkpoint.load(start, task)
    if state["config"] is None:
        return configuration_of(start, task)
    return trained_cfg(start, state)


def _require_effect(options: list[str], cfg: TaskCfg) -> None:
    """Raises UserError if an option would change nothing in a resumed run."""
    fields = {f"--agent.{name}".replace("_", "-"): "the value in its checkpoint" for name in cfg.agent.START_ONLY}
    terms = {f"curriculum.{name}": term for name, term in cfg.env.curriculum.items()}
    terms |= {f"events.{name}": term for name, term in cfg.env.events.items()}
    for place, term in terms.items():
        for parameter in getattr(term.func, "START_ONLY", ()):
            option = f"--env.{place}.params.{parameter}".replace("_", "-")
            fields[option] = "the value in its checkpoint"
    fields |= {
        "--env.seed": "the random numbers of its checkpoint",
        "--preset": "its scale; change single options instead",
        "--init": "its own networks",
        "--calibration": "the calibration it was started with",
        "--run-dir": "its own folder",
    }
    for option in option_groups(options):
        if option in fields:
            raise UserError(f"{option} has no effect on a resumed run, which keeps {fields[option]}.")


def _introduce(console: Console, task: str, env: ManagerBasedRlEnv, run_dir: Path) -> None:
    device = torch.cuda.get_device_name(env.device) if env.device.type == "cuda" else f"{usable_cores()} cores"
    sim = env.cfg.sim
    console.print(f"[bold]{task}[/bold] on {env.device} ({device}), physics '{env.sim.backend}'")
    console.print(
        f"{env.num_envs} envs, {sim.timestep * 1e3:g} ms x {sim.decimation}, {sim.cone} cone, terrain of "
        f"{env.tiles.num_levels} levels; run folder {run_dir}"
    )
    env.describe(console)


def _introduce_origin(console: Console, cfg: TaskCfg, origin: Origin) -> None:
    if (parent := origin.parent) is None:
        return
    console.print(
        f"Starts from the actor of {parent.path}: {parent.task}, iteration {parent.iteration}, "
        f"{parent.seen}. {parent.training} {origin.calibration}",
        soft_wrap=True,
        highlight=False,
    )
    state = checkpoint.load(parent.path)
    if state["config"] is None:
        return
    if changed := departures(state, trained_cfg(parent.path, state), cfg, spec_of(state).groups):
        console.print(
            f"[yellow]It was trained with another {changed} than this task has.[/yellow]",
            soft_wrap=True,
            highlight=False,
        )
