"""`humoslope calibrate CHECKPOINT`: the swing reference that Stage II tracks, measured on a Stage-I policy."""

from __future__ import annotations

import dataclasses
import math
import time
from pathlib import Path
from typing import Annotated, ClassVar

import torch
import tyro
from rich.console import Console

from humoslope.cli.arguments import parse_options
from humoslope.cli.measure import describe, introduce, trained, walking, warn
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.evaluation.ramps import ramp_env_cfg
from humoslope.evaluation.swing.figure import draw
from humoslope.evaluation.swing.file import calibration_path, write_calibration
from humoslope.evaluation.swing.fit import Fit, SwingFit, gather, solve, table
from humoslope.evaluation.swing.samples import SwingProtocol, collect_samples
from humoslope.extras import MATPLOTLIB, installed, missing
from humoslope.files import check_place
from humoslope.learning.policy import load_actor, read_spec
from humoslope.mdp.selection import joint_pair
from humoslope.provenance import plain
from humoslope.ranges import Checked
from humoslope.slope.swing import PRIOR


@dataclasses.dataclass(frozen=True)
class Options(Checked):
    """Lets a trained policy walk up and down ramps and fits the hip flexion of its swing leg against the slope.

    Attributes:
        checkpoint: Path of a checkpoint; a run folder stands for its newest one.
        protocol: Settings of the walks, and of the instants that count.
        fit: Settings of the fit.
        out: Path of the JSON file with the calibration, by default beside the checkpoint; a picture is written beside
            it.
    """

    VERB: ClassVar[str] = "calibrate"

    checkpoint: tyro.conf.Positional[Path]
    protocol: Annotated[SwingProtocol, tyro.conf.arg(name="")] = dataclasses.field(default_factory=SwingProtocol)
    fit: Annotated[Fit, tyro.conf.arg(name="")] = dataclasses.field(default_factory=Fit)
    out: Path | None = None


def run(arguments: list[str]) -> None:
    """Calibrates on the checkpoint named in `arguments`."""
    options = parse_options(Options, arguments, "calibrate")
    provenance, task = trained(options.checkpoint)
    path = provenance.path
    out = options.out or calibration_path(path)
    check_place(out)
    picture = out.with_suffix(".png")
    if picture == out:
        raise UserError(
            f"--out '{out}' is where the picture goes; name the JSON file, such as '{calibration_path(out)}'."
        )
    check_place(picture)

    protocol, fit, console = options.protocol, options.fit, Console()
    cfg = ramp_env_cfg(task.env, protocol, read_spec(path).groups)
    joint_pair(cfg.scene.robot, protocol.hip, torch.device("cpu"))  # a mistake is said before anything is built
    env = ManagerBasedRlEnv(cfg)
    actor = load_actor(path, env, provenance.task)
    introduce(console, env, provenance, protocol)
    started = time.monotonic()
    with walking(console, env, protocol.seconds) as on_step:
        samples = collect_samples(env, actor, protocol, on_step)
    took = time.monotonic() - started

    warnings = env.sim.warnings()
    warn(console, warnings)
    bins = gather(samples, fit, protocol.grades)
    try:
        found = solve(bins, fit)
    except UserError:
        console.print(table(bins, fit, None))
        raise
    console.print(table(bins, fit, found))
    _say(console, found)
    meta = describe(env, provenance, protocol, took, warnings, ["calibrate", *arguments])
    write_calibration(out, found, {"fit": plain(fit), "samples": len(samples), **meta})
    if installed(MATPLOTLIB):
        draw(samples, found, fit, f"{path.name}, iteration {provenance.iteration}", picture)
        console.print(f"wrote {out} and {picture}", soft_wrap=True)
    else:
        console.print(f"wrote {out}\n{missing('its picture', MATPLOTLIB)}", soft_wrap=True)


def _say(console: Console, found: SwingFit) -> None:
    fitted, prior, (residual, grade) = found.calibration, PRIOR, found.worst
    console.print(
        f"beta0 {fitted.beta0:.4f} +- {found.beta0_error:.4f} rad, beta1 {fitted.beta1:.4f} +- {found.beta1_error:.4f} "
        f"rad/rad, theta_clip {math.degrees(fitted.theta_clip):g}°\n"
        f"RMS residual {found.rms_residual:.4f} rad; largest {residual:+.4f} rad at {grade:g}°\n"
        f"prior for comparison: beta0 {prior.beta0:g} rad, beta1 {prior.beta1:g} rad/rad",
        highlight=False,
        soft_wrap=True,
    )
