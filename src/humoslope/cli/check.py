"""`humoslope check TASK`: whether this installation computes the right physics, and how fast it is."""

from __future__ import annotations

import dataclasses
import gc
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import torch
from rich.console import Console
from rich.table import Table

from humoslope.check.finding import Finding
from humoslope.check.host_sync import check_host_sync
from humoslope.check.learning import check_speed, check_training, read_end
from humoslope.check.machine import describe_machine
from humoslope.check.physics import check_contacts, check_graphs, check_motion, check_rollout
from humoslope.cli.options import named_task, parse
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.files import check_place
from humoslope.learning import checkpoint as checkpoints
from humoslope.learning.benchmark import Measurement
from humoslope.presets import Preset
from humoslope.registry import TaskCfg
from humoslope.seal import finite, write_json
from humoslope.sim.device import find_device

Backend = Literal["auto", "native", "warp"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Checks an installation, within ten minutes: versions and driver, contacts and motion of both backends near and
    far from the height field's centre, graph capture, full buffers, host syncs, speed and memory, a short training.
    Exits with 0 if everything is right and with 1 if something is not.

    Attributes:
        preset: Scale of everything but the number of envs; "auto" for what the machine has.
        checkpoint: A trained policy of the task that the short training goes on from.
        curve: Table of that run's curve (humoslope curve --table), whose end the short training is compared with.
        quick: Smaller checks; under two minutes on a CPU once the kernels are compiled.
        out: JSON file for everything that was measured.
    """

    preset: Preset = "auto"
    checkpoint: str = ""
    curve: str = ""
    quick: bool = False
    out: str = ""


@dataclasses.dataclass(frozen=True)
class Scale:
    """Sizes of the checks.

    Attributes:
        rollout: Envs and steps of random actions on the warp backend.
        syncs: Envs and steps while host syncs are errors.
        sizes, rounds: Numbers of envs whose speed is measured, and how often.
        training: Envs and iterations of the short training.
    """

    rollout: tuple[int, int]
    syncs: tuple[int, int]
    sizes: tuple[int, ...]
    rounds: int
    training: tuple[int, int]


SCALES = {
    ("cuda", False): Scale((4096, 100), (1024, 30), (1024, 4096, 8192), 3, (4096, 20)),
    ("cuda", True): Scale((1024, 50), (256, 30), (1024, 4096), 1, (4096, 8)),
    ("cpu", False): Scale((64, 100), (64, 30), (64, 256, 512), 3, (512, 20)),
    ("cpu", True): Scale((16, 25), (16, 30), (256,), 1, (128, 8)),
}
"""Sizes by device and `quick`."""


def run(arguments: list[str]) -> None:
    """Checks this installation with the task named in `arguments`."""
    named = named_task("check", arguments)
    if named is None:
        return
    task, typed = named
    cfg, options = parse(Options(), task, typed, "check")
    checkpoint = Path(options.checkpoint) if options.checkpoint else None
    curve = Path(options.curve) if options.curve else None
    if checkpoint is not None:
        checkpoints.load(checkpoint, task)
    if curve is not None:
        read_end(curve)
        if checkpoint is None:
            raise UserError("check: --curve is what a run from --checkpoint is compared with; give that too.")
    if options.out:
        check_place(Path(options.out))
    device = find_device(cfg.env.sim.backend, cfg.env.sim.device)

    console = Console(width=None if sys.stdout.isatty() else 120)
    scale = SCALES[device.type, options.quick]
    speeds: list[Measurement] = []
    findings: dict[str, list[Finding]] = {}
    start = time.perf_counter()
    for name, check in checks(task, cfg, device, scale, checkpoint, curve, speeds):
        console.print(f"{name} ...", highlight=False)
        findings[name] = guarded(check)
    seconds = time.perf_counter() - start
    wrong = sum(not finding.right for group in findings.values() for finding in group)
    console.print(table(findings))
    verdict = "[green]all right[/green]" if not wrong else f"[red]{wrong} wrong[/red]"
    console.print(f"{verdict}, {seconds:.0f} s", highlight=False)
    if options.out:
        report = {
            "what": "check",
            "task": task,
            "options": typed,
            "right": not wrong,
            "seconds": seconds,
            "checks": {name: [dataclasses.asdict(finding) for finding in group] for name, group in findings.items()},
            "speeds": [dataclasses.asdict(speed) for speed in speeds],
        }
        write_json(Path(options.out), finite(report))
        console.print(f"wrote {options.out}", soft_wrap=True)
    if wrong:
        sys.exit(1)


def checks(
    task: str,
    cfg: TaskCfg,
    device: torch.device,
    scale: Scale,
    checkpoint: Path | None,
    curve: Path | None,
    speeds: list[Measurement],
) -> list[tuple[str, Callable[[], list[Finding]]]]:
    """The checks in order, by name. Measured speeds are appended to `speeds`."""

    def env_of(num_envs: int, backend: Backend | None = None) -> ManagerBasedRlEnv:
        return ManagerBasedRlEnv(resized(cfg, num_envs, device, backend).env)

    def speed() -> list[Finding]:
        found, results = check_speed(task, resized(cfg, 1, device), scale.sizes, scale.rounds)
        speeds.extend(results)
        return found

    envs, iterations = scale.training
    where = str(device)
    return [
        ("machine", lambda: describe_machine(device)),
        ("contacts", lambda: check_contacts(where)),
        ("motion", lambda: check_motion(cfg.env, where)),
        ("graphs", lambda: check_graphs(cfg.env, where)),
        ("random actions", lambda: check_rollout(env_of(scale.rollout[0], "warp"), scale.rollout[1])),
        ("host syncs", lambda: check_host_sync(env_of(scale.syncs[0]), scale.syncs[1])),
        ("speed", speed),
        ("training", lambda: check_training(task, resized(cfg, envs, device), iterations, checkpoint, curve)),
    ]


def resized(cfg: TaskCfg, num_envs: int, device: torch.device, backend: Backend | None = None) -> TaskCfg:
    """The task with another number of envs, on a device."""
    sim = dataclasses.replace(cfg.env.sim, device=str(device), backend=backend or cfg.env.sim.backend)
    return dataclasses.replace(cfg, env=dataclasses.replace(cfg.env, num_envs=num_envs, sim=sim))


def guarded(check: Callable[[], list[Finding]]) -> list[Finding]:
    """The findings of a check; one that stops with an error is wrong, and the others still run."""
    try:
        return check()
    except UserError as error:
        return [Finding("stopped", str(error), "", right=False)]
    except Exception as error:
        traceback.print_exc()
        return [Finding("stopped", f"{type(error).__name__}: {error}", "", right=False)]
    finally:
        gc.collect()  # an environment of thousands of envs holds gigabytes


def table(findings: dict[str, list[Finding]]) -> Table:
    """A row for each finding."""
    result = Table(title="Check of this installation")
    for column in ("check", "measured quantity", "value", "right if", ""):
        result.add_column(column, overflow="fold")
    for name, group in findings.items():
        for row, finding in enumerate(group):
            mark = ("[green]ok[/green]" if finding.wanted else "") if finding.right else "[red]WRONG[/red]"
            result.add_row(name if row == 0 else "", finding.subject, finding.measured, finding.wanted, mark)
        result.add_section()
    return result
