"""`humoslope ramps CHECKPOINT`: falls and speed of a policy on flat ground and on ramps."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Annotated, ClassVar

import tyro
from rich.console import Console

from humoslope.cli.arguments import parse_options
from humoslope.cli.measure import describe, introduce, subject, walking, warn
from humoslope.env import ManagerBasedRlEnv
from humoslope.evaluation.ramps import RampProtocol, ramp_env_cfg, run_trials, summarise, table
from humoslope.files import check_place
from humoslope.provenance import plain
from humoslope.ranges import Checked
from humoslope.seal import write_json


@dataclasses.dataclass(frozen=True)
class Options(Checked):
    """Lets a trained policy walk on flat ground and on ramps, without noise or harness, and counts its falls.

    With --speed 0 it is commanded to stand there, and its creep and its steps are measured. It may also be commanded
    to walk backward (--speed -0.3), to a side (--speed 0 --lateral 0.3) or across the slope (--across), or to turn in
    place (--speed 0 --yaw-rate 0.6), and be pushed (--push 1.0).

    Attributes:
        checkpoint: Path of a checkpoint; a run folder stands for its newest one. An export folder is taken
            as well, also of an imported policy.
        protocol: Settings of the measurement.
        out: Path of the JSON file with the results; by default beside the checkpoint, or in the export
            folder.
    """

    VERB: ClassVar[str] = "ramps"

    checkpoint: tyro.conf.Positional[Path]
    protocol: Annotated[RampProtocol, tyro.conf.arg(name="")] = dataclasses.field(default_factory=RampProtocol)
    out: Path | None = None


def run(arguments: list[str]) -> None:
    """Evaluates the checkpoint named in `arguments`."""
    options = parse_options(Options, arguments, "ramps")
    measured = subject(options.checkpoint)
    provenance, out = measured.provenance, options.out or measured.beside("ramps.json")
    check_place(out)

    protocol, console = options.protocol, Console()
    env = ManagerBasedRlEnv(ramp_env_cfg(measured.env, protocol, measured.groups))
    actor = measured.load(env)
    introduce(console, env, provenance, protocol)
    started = time.monotonic()
    with walking(console, env, protocol.seconds) as on_step:
        results = summarise(run_trials(env, actor, protocol, on_step), protocol)
    took = time.monotonic() - started

    warnings = env.sim.warnings()
    report = {
        "what": "ramps",
        **describe(env, provenance, protocol, took, warnings, ["ramps", *arguments]),
        "ramps": [plain(r) | {"fall_share": r.falls.share} for r in results],
    }
    write_json(out, report)
    console.print(table(results))
    console.print(provenance.training, soft_wrap=True, highlight=False)
    warn(console, warnings)
    console.print(f"wrote {out}", soft_wrap=True)
