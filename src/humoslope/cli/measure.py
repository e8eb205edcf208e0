"""Parts that all verbs share in which a trained policy walks."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

import humoslope
from humoslope.cli.options import configuration_of
from humoslope.deploy import contract as contracts
from humoslope.env import ManagerBasedRlEnv
from humoslope.evaluation.exports import of_export
from humoslope.evaluation.ramps import RampProtocol
from humoslope.evaluation.subject import Subject, of_checkpoint
from humoslope.learning import checkpoint as checkpoints
from humoslope.learning.configuration import changes_since, trained_cfg
from humoslope.learning.policy import Provenance, find_checkpoint, provenance_of, spec_of
from humoslope.provenance import git_state, plain
from humoslope.registry import TaskCfg, load_content

MEASURED = ("actions", "command", "observations", "terminations", "events")
"""Parts of the environment's configuration that are written with results."""


def trained(checkpoint: Path) -> tuple[Provenance, TaskCfg]:
    """The origin of a checkpoint, or of the newest one of a run folder, and the configuration it was trained with.

    Where today's task differs in what the policy sees or moves, a sentence is printed.

    Raises:
        UserError: If it is no checkpoint, or of a task that is not registered.
    """
    load_content()
    path = find_checkpoint(checkpoint)
    state = checkpoints.load(path)
    provenance = provenance_of(path, state)
    if state["config"] is None:
        return provenance, configuration_of(path, provenance.task)
    cfg = trained_cfg(path, state)
    if changed := changes_since(path, state, cfg, spec_of(state).groups):
        print(changed)
    return provenance, cfg


def subject(path: Path) -> Subject:
    """A policy to be measured: a checkpoint, the newest one of a run folder, or an export.

    Raises:
        UserError: If it is none of them, or of a task or a robot that is not registered.
    """
    if (contracts.located(path) / contracts.FILE).is_file():
        load_content()
        return of_export(path)
    return of_checkpoint(*trained(path))


def introduce(console: Console, env: ManagerBasedRlEnv, provenance: Provenance, protocol: RampProtocol) -> None:
    """Prints which checkpoint walks on which ground, in which physics."""
    sim = env.cfg.sim
    friction = f"friction max({protocol.friction:g}, tan|grade| + {protocol.friction_margin:g})"
    console.print(
        f"[bold]{provenance.title}[/bold], {provenance.seen}\n"
        f"{env.num_envs} envs, {protocol.starts} for each of {len(protocol.grades)} grades; "
        f"{protocol.in_words} for {protocol.seconds:g} s; {friction}\n"
        f"physics '{env.sim.backend}' on {env.device}, {sim.timestep * 1e3:g} ms x {sim.decimation}, {sim.cone} cone; "
        f"no noise, {'' if protocol.push else 'pushes, '}harness or randomisation but the start",
        highlight=False,
        soft_wrap=True,
    )


@contextmanager
def walking(console: Console, env: ManagerBasedRlEnv, seconds: float) -> Iterator[Callable[[], None]]:
    """Shows the progress through `seconds` of walking; yields a function to call after every control step."""
    columns = (
        TextColumn("walking"),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.fields[speed]} steps/s, left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as progress:
        bar = progress.add_task("", total=env.num_envs * round(seconds / env.step_dt), speed="-")

        def on_step() -> None:
            speed = progress.tasks[0].speed
            progress.update(bar, advance=env.num_envs, speed=f"{speed:,.0f}" if speed else "-")

        yield on_step


def warn(console: Console, warnings: list[str]) -> None:
    """Prints the warnings of the physics."""
    for warning in warnings:
        console.print(f"[yellow]physics: {warning}[/yellow]")


def describe(
    env: ManagerBasedRlEnv,
    provenance: Provenance,
    protocol: RampProtocol,
    took: float,
    warnings: list[str],
    command: list[str],
) -> dict[str, Any]:
    """Returns the origin of results, as JSON types.

    Args:
        took: Duration of the walks in real time, s.
        warnings: Warnings of the physics.
        command: Verb with its arguments.
    """
    checkpoint = plain(provenance)
    harness = checkpoint.pop("harness")
    return {
        "version": humoslope.__version__,
        "code": git_state().splitlines()[0],
        "checkpoint": checkpoint,
        "training_harness": {"used": harness is not None, "scale_at_checkpoint": harness},
        "protocol": plain(protocol),
        "physics": plain(env.cfg.sim) | {"backend": env.sim.backend, "device": str(env.device)},
        "environment": {name: plain(getattr(env.cfg, name)) for name in MEASURED},
        "physics_warnings": warnings,
        "wall_clock_s": round(took, 1),
        "command_line": shlex.join(["humoslope", *command]),
    }
