"""`humoslope train TASK`: trains in a run folder, and resumes."""

from __future__ import annotations

import dataclasses
import os
import shlex
from datetime import datetime
from pathlib import Path
from typing import Any, Literal

import torch
import tyro
from rich.console import Console

from humoslope.cli.overrides import mirror_type, write_back
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.registry import TaskCfg, all_tasks, build_task, load_content
from humoslope.rl import checkpoint
from humoslope.rl.config import apply_preset
from humoslope.rl.rundir import describe_run, find_run, tee
from humoslope.rl.runner import Runner, seed_everything


@dataclasses.dataclass(frozen=True)
class TrainArgs:
    """Where and how to train.

    Attributes:
        preset: Scale: "cpu", "gpu", or "auto" for what the machine has.
        resume: A run folder, or "latest": continue its last checkpoint, with the options it was started with.
        run_dir: Folder of a new run. By default logs/TASK/TIME.
        init: A checkpoint of any task to take the actor from; training starts at iteration 0.
    """

    preset: Literal["auto", "cpu", "gpu"] = "auto"
    resume: str = ""
    run_dir: str = ""
    init: str = ""


def run(arguments: list[str]) -> None:
    """Trains the task named first in `arguments`."""
    load_content()
    if not arguments or arguments[0].startswith("-"):
        raise UserError(f"train needs a task: {', '.join(all_tasks())}.")
    task, options = arguments[0], arguments[1:]
    build_task(task)  # a typing mistake in the name is said before anything else

    args, _ = tyro.cli(TrainArgs, args=[o for o in options if o not in ("-h", "--help")], return_unknown_args=True)
    run_dir = find_run(task, args.resume) if args.resume else None
    if run_dir is not None:
        options = [*_saved_options(run_dir), *options]
    cfg, args = parse(task, options)
    _train(task, cfg, args, run_dir, options)


def parse(task: str, options: list[str]) -> tuple[TaskCfg, TrainArgs]:
    """The task's configuration with preset and overrides applied, and the other options."""
    early, _ = tyro.cli(TrainArgs, args=[o for o in options if o not in ("-h", "--help")], return_unknown_args=True)
    cfg = build_task(task)
    preset = early.preset
    if preset == "auto":
        preset = "gpu" if torch.cuda.is_available() else "cpu"
    apply_preset(cfg, preset)
    mirrored = mirror_type("Options", {**vars(TrainArgs()), "env": cfg.env, "agent": cfg.agent})
    assert mirrored is not None
    kind, default = mirrored
    parsed: Any = tyro.cli(
        kind, args=options, default=default, prog=f"humoslope train {task}", description=(TrainArgs.__doc__ or "")
    )
    write_back(cfg.env, parsed.env)
    write_back(cfg.agent, parsed.agent)
    return cfg, TrainArgs(**{f.name: getattr(parsed, f.name) for f in dataclasses.fields(TrainArgs)})


def _train(task: str, cfg: TaskCfg, args: TrainArgs, resumed: Path | None, options: list[str]) -> None:
    rank, world_size = int(os.getenv("RANK", "0")), int(os.getenv("WORLD_SIZE", "1"))
    if world_size > 1:
        cfg.env.sim.device = f"cuda:{os.environ['LOCAL_RANK']}"
    # Every process draws its own randomness.
    seed_everything(cfg.env.seed + rank)
    cfg.env.seed += rank
    cfg.agent.to_rsl_rl()  # impossible numbers are said before anything is built or written

    env = ManagerBasedRlEnv(cfg.env)
    start = resumed is not None and checkpoint.latest(resumed)
    run_dir = resumed or Path(args.run_dir or Path("logs") / task / datetime.now().strftime("%Y-%m-%d_%H-%M-%S"))
    if resumed is None and run_dir.exists() and any(run_dir.glob("model_*.pt")):
        raise UserError(
            f"run folder '{run_dir}' holds a run already; resume it with --resume {run_dir}, or choose another."
        )
    with tee(run_dir / "console.log" if rank == 0 else None) as console:
        _introduce(console, task, env, run_dir)
        runner = Runner(task, env, cfg.agent, run_dir if rank == 0 else None, console)
        if start:
            runner.resume(start)
            console.print(f"Resumed from {start}.")
        elif args.init:
            runner.warm_start(Path(args.init))
        if rank == 0:
            describe_run(run_dir, task, cfg, _keep(options))
        runner.train()


def _introduce(console: Console, task: str, env: ManagerBasedRlEnv, run_dir: Path) -> None:
    device = torch.cuda.get_device_name(env.device) if env.device.type == "cuda" else f"{os.cpu_count()} cores"
    sim = env.cfg.sim
    console.print(f"[bold]{task}[/bold] on {env.device} ({device}), physics '{env.sim.backend}'")
    console.print(
        f"{env.num_envs} worlds, {sim.timestep * 1e3:g} ms x {sim.decimation}, {sim.cone} cone, terrain of "
        f"{env.tiles.num_levels} levels; run folder {run_dir}"
    )
    env.describe(console)


def _keep(options: list[str]) -> list[str]:
    """The options without those that only concern how this process was started."""
    kept, skip = [], False
    for option in options:
        if skip:
            skip = False
        elif option in ("--resume", "--run-dir", "--init"):
            skip = True
        elif not option.startswith(("--resume=", "--run-dir=", "--init=")):
            kept.append(option)
    return kept


def _saved_options(run_dir: Path) -> list[str]:
    file = run_dir / "options.txt"
    return shlex.split(file.read_text()) if file.is_file() else []
