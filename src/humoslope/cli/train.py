"""`humoslope train TASK`: trains in a run folder, and resumes."""

from __future__ import annotations

import dataclasses
import os
from datetime import datetime
from pathlib import Path

import torch
from rich.console import Console

from humoslope.cli.options import early, parse, saved_options
from humoslope.cli.overrides import merge_options
from humoslope.cli.warm_start import Origin, find_origin
from humoslope.cpu import usable_cores
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.files import check_place
from humoslope.learning import checkpoint
from humoslope.learning.run_folder import describe_run, find_run, tee
from humoslope.learning.runner import Runner, seed_everything
from humoslope.presets import Preset
from humoslope.registry import TaskCfg, all_tasks, build_task, load_content


@dataclasses.dataclass(frozen=True)
class TrainArgs:
    """Where and how to train.

    Attributes:
        preset: Scale: "cpu", "gpu", or "auto" for what the machine has.
        resume: A run folder, or "latest": continue its last checkpoint, with the options it was started with.
        run_dir: Folder of a new run. By default logs/TASK/TIME.
        init: A checkpoint, or a run folder for its newest one, to take the actor from; training starts at iteration 0.
            A task that goes on from another one finds it by itself.
        calibration: A swing calibration, or "prior" for the values in the task's configuration. By default the one
            beside the checkpoint that is started from.
    """

    preset: Preset = "auto"
    resume: str = ""
    run_dir: str = ""
    init: str = ""
    calibration: str = ""


def run(arguments: list[str]) -> None:
    """Trains the task named first in `arguments`."""
    load_content()
    if arguments and arguments[0] in ("-h", "--help"):
        print("humoslope train TASK [...]; humoslope train TASK --help lists every option.\n")
        print("\n".join(f"  {name}  {line}" for name, line in all_tasks().items()))
        return
    if not arguments or arguments[0].startswith("-"):
        raise UserError(f"train needs a task: {', '.join(all_tasks())}.")
    task, options = arguments[0], arguments[1:]
    earlier = build_task(task).start  # a typing mistake in the name is said before anything else

    own = early(TrainArgs(), task, options)
    resumed = find_run(task, own.resume) if own.resume else None
    if resumed is not None:
        origin, options = Origin(), merge_options(saved_options(resumed), options)
    else:
        origin = find_origin(earlier, own.init, own.calibration)
        options = merge_options([*origin.options], options)  # what the user typed wins
    cfg, args = parse(TrainArgs(), task, options)
    # A resumed run keeps its scale on any machine.
    once = ("--resume", "--run-dir", "--init", "--calibration")
    kept = merge_options(options, ["--preset", args.preset], without=once)
    _train(task, cfg, args, resumed, origin, kept)


def _train(task: str, cfg: TaskCfg, args: TrainArgs, resumed: Path | None, origin: Origin, options: list[str]) -> None:
    rank, world_size = int(os.getenv("RANK", "0")), int(os.getenv("WORLD_SIZE", "1"))
    if world_size > 1:
        cfg.env.sim.device = f"cuda:{os.environ['LOCAL_RANK']}"
    # Every process draws its own randomness.
    cfg.env.seed += rank
    seed_everything(cfg.env.seed)

    # What can be wrong is said before anything is written, and as far as possible before anything is built.
    cfg.agent.to_rsl_rl()
    run_dir = resumed or Path(args.run_dir or Path("logs") / task / datetime.now().strftime("%Y-%m-%d_%H-%M-%S"))
    start = checkpoint.latest(resumed) if resumed else None
    if start is not None:
        checkpoint.load(start, task)
    elif rank == 0:
        _check_new(run_dir)
    env = ManagerBasedRlEnv(cfg.env)
    with tee(run_dir / "console.log" if rank == 0 else None) as console:
        runner = Runner(task, env, cfg.agent, run_dir if rank == 0 else None, console)
        if start is not None:
            runner.resume(start)
        elif origin.earlier is not None:
            runner.warm_start(origin.earlier.path)
        if rank == 0:
            describe_run(run_dir, task, cfg, options)
        _introduce(console, task, env, run_dir)
        if start is not None:
            console.print(f"Resumed from {start}.")
        if (earlier := origin.earlier) is not None:
            console.print(
                f"Starts from the actor of {earlier.path}: {earlier.task}, iteration {earlier.iteration}, "
                f"{earlier.total_steps / 1e6:.2f} M steps. {earlier.training} {origin.calibration}",
                soft_wrap=True,
                highlight=False,
            )
        runner.train()


def _check_new(run_dir: Path) -> None:
    """Raises UserError unless a new run can be put there."""
    if any(run_dir.glob("model_*.pt")):
        raise UserError(
            f"run folder '{run_dir}' holds a run already; resume it with --resume {run_dir}, or choose another."
        )
    if any((run_dir / name).exists() for name in ("config.json", "console.log")):
        raise UserError(f"run folder '{run_dir}' holds a run that left no checkpoint; remove it, or choose another.")
    check_place(run_dir / "config.json")


def _introduce(console: Console, task: str, env: ManagerBasedRlEnv, run_dir: Path) -> None:
    device = torch.cuda.get_device_name(env.device) if env.device.type == "cuda" else f"{usable_cores()} cores"
    sim = env.cfg.sim
    console.print(f"[bold]{task}[/bold] on {env.device} ({device}), physics '{env.sim.backend}'")
    console.print(
        f"{env.num_envs} worlds, {sim.timestep * 1e3:g} ms x {sim.decimation}, {sim.cone} cone, terrain of "
        f"{env.tiles.num_levels} levels; run folder {run_dir}"
    )
    env.describe(console)
