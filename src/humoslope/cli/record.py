"""`humoslope record CHECKPOINT`: lets a policy walk once and keeps the walk as a rollout file."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, ClassVar

import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from humoslope.cli.arguments import parse_options
from humoslope.cli.measure import trained, warn
from humoslope.env import ManagerBasedRlEnv
from humoslope.files import check_place
from humoslope.learning.policy import load_actor, read_spec
from humoslope.ranges import Checked
from humoslope.replay.record import RecordProtocol, record, record_env_cfg, with_provenance


@dataclasses.dataclass(frozen=True)
class Options(Checked):
    """Lets a trained policy walk once, and writes the walk to a file that `replay` and `video` show.

    Attributes:
        checkpoint: Path of a checkpoint; a run folder stands for its newest one.
        protocol: Settings of the walk.
        out: Path of the rollout; by default beside the checkpoint.
        label: Name of the walk in viewers; by default the checkpoint's name.
    """

    VERB: ClassVar[str] = "record"

    checkpoint: tyro.conf.Positional[Path]
    protocol: Annotated[RecordProtocol, tyro.conf.arg(name="")] = dataclasses.field(default_factory=RecordProtocol)
    out: Path | None = None
    label: str | None = None


def run(arguments: list[str]) -> None:
    """Records the checkpoint named in `arguments`."""
    options = parse_options(Options, arguments, "record")
    protocol, console = options.protocol, Console()
    provenance, task = trained(options.checkpoint)
    path = provenance.path
    grade = protocol.resolve_grade()
    out = options.out or path.with_name(f"{path.stem}.{protocol.terrain}-{grade:g}.rollout.npz")
    check_place(out)
    env = ManagerBasedRlEnv(record_env_cfg(task.env, protocol, read_spec(path).groups))
    actor = load_actor(path, env, provenance.task)
    console.print(
        f"{provenance.name}, iteration {provenance.iteration}: {protocol.terrain} at {grade:g}°, "
        f"{protocol.speed:g} m/s, {protocol.seconds:g} s; physics '{env.sim.backend}', "
        f"{env.cfg.sim.timestep * 1e3:g} ms x {env.cfg.sim.decimation}, {env.cfg.sim.cone} cone",
        highlight=False,
        soft_wrap=True,
    )
    columns = (TextColumn("walking"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as progress:
        bar = progress.add_task("", total=round(protocol.seconds / env.step_dt))
        rollout = record(env, actor, protocol, lambda: progress.advance(bar))
    with_provenance(rollout, provenance, options.label or path.stem).save(out)
    for event in rollout.events:
        console.print(f"{event.time:7.2f} s  {event.text}", highlight=False)
    warn(console, env.sim.warnings())
    console.print(f"wrote {out} ({out.stat().st_size / 1e6:.1f} MB)", soft_wrap=True)
