"""`humoslope ramps CHECKPOINT`: how a policy does on flat ground and on ramps."""

from __future__ import annotations

import dataclasses
import json
import os
import shlex
import time
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

import humoslope
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.evaluation.ramps import RampProtocol, RampResult, ramp_env_cfg, summarise, table, walk
from humoslope.files import write_text
from humoslope.registry import build_task, load_content
from humoslope.rl.policy import Actor, Provenance, find_checkpoint, load_actor, read_provenance
from humoslope.rl.rundir import git_state, plain

MEASURED = ("actions", "command", "observations", "terminations", "events")
"""What the written figures say of the environment."""


@dataclasses.dataclass(frozen=True)
class Options:
    """Lets a trained policy walk on flat ground and on ramps, without noise, pushes or harness, and counts its falls.

    Attributes:
        checkpoint: A checkpoint, or a run folder for its newest one.
        protocol: What is measured.
        out: Where the figures are written as JSON; by default beside the checkpoint.
    """

    checkpoint: tyro.conf.Positional[Path]
    protocol: Annotated[RampProtocol, tyro.conf.arg(name="")] = dataclasses.field(default_factory=RampProtocol)
    out: Path | None = None


def run(arguments: list[str]) -> None:
    """Evaluates the checkpoint named in `arguments`."""
    options = tyro.cli(Options, args=arguments, prog="humoslope ramps")
    load_content()
    path = find_checkpoint(options.checkpoint)
    provenance = read_provenance(path)
    out = options.out or path.with_suffix(".ramps.json")
    _check_place(out)

    protocol, console = options.protocol, Console()
    cfg = ramp_env_cfg(build_task(provenance.task).env, protocol)
    env = ManagerBasedRlEnv(cfg)
    actor = load_actor(path, env, provenance.task)
    _introduce(console, env, provenance, protocol)
    started = time.monotonic()
    results = _walk(console, env, actor, protocol)
    took = time.monotonic() - started

    warnings = env.sim.warnings()
    console.print(table(results))
    console.print(provenance.training, soft_wrap=True, highlight=False)
    for warning in warnings:
        console.print(f"[yellow]physics: {warning}[/yellow]")
    report = _report(env, provenance, protocol, results) | {
        "physics_warnings": warnings,
        "wall_clock_s": round(took, 1),
        "command_line": shlex.join(["humoslope", "ramps", *arguments]),
    }
    write_text(out, json.dumps(report, indent=2, allow_nan=False) + "\n")
    console.print(f"wrote {out}", soft_wrap=True)


def _introduce(console: Console, env: ManagerBasedRlEnv, provenance: Provenance, protocol: RampProtocol) -> None:
    sim, seen = env.cfg.sim, f"{provenance.total_steps / 1e6:.2f} M steps"
    friction = f"friction max({protocol.friction:g}, tan|grade| + {protocol.friction_margin:g})"
    console.print(
        f"[bold]{provenance.task}[/bold], iteration {provenance.iteration}, {seen}\n"
        f"{env.num_envs} worlds, {protocol.starts} for each of {len(protocol.grades)} grades; "
        f"{protocol.speed:g} m/s for {protocol.seconds:g} s; {friction}\n"
        f"physics '{env.sim.backend}' on {env.device}, {sim.timestep * 1e3:g} ms x {sim.decimation}, {sim.cone} cone; "
        "no noise, pushes, harness or randomisation but the start",
        highlight=False,
        soft_wrap=True,
    )


def _walk(console: Console, env: ManagerBasedRlEnv, actor: Actor, protocol: RampProtocol) -> list[RampResult]:
    columns = (
        TextColumn("walking"),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.fields[speed]} steps/s, left"),
        TimeRemainingColumn(),
    )
    total = env.num_envs * round(protocol.seconds / env.step_dt)
    with Progress(*columns, console=console) as progress:
        bar = progress.add_task("", total=total, speed="-")

        def on_step() -> None:
            speed = progress.tasks[0].speed
            progress.update(bar, advance=env.num_envs, speed=f"{speed:,.0f}" if speed else "-")

        trials = walk(env, actor, protocol, on_step)
    return summarise(trials, protocol)


def _report(
    env: ManagerBasedRlEnv, provenance: Provenance, protocol: RampProtocol, results: list[RampResult]
) -> dict[str, Any]:
    checkpoint = plain(provenance)
    harness = checkpoint.pop("harness")
    return {
        "what": "ramps",
        "version": humoslope.__version__,
        "code": git_state().splitlines()[0],
        "checkpoint": checkpoint,
        "training_harness": {"used": harness is not None, "scale_at_checkpoint": harness},
        "protocol": plain(protocol),
        "physics": plain(env.cfg.sim) | {"backend": env.sim.backend, "device": str(env.device)},
        "environment": {name: plain(getattr(env.cfg, name)) for name in MEASURED},
        "ramps": [plain(r) | {"fall_share": r.falls.share} for r in results],
    }


def _check_place(out: Path) -> None:
    """Says that nothing can be written there before minutes of walking, not after."""
    if out.is_dir():
        raise UserError(f"--out '{out}' is a folder; name a file in it.")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"cannot write to '{out}': {error.strerror}.") from None
    if not os.access(out.parent, os.W_OK):
        raise UserError(f"cannot write to '{out}': the folder is not writable.")
