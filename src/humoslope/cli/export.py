"""`humoslope export CHECKPOINT`: a policy as files that run without this framework."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import tyro
from rich.console import Console

from humoslope.cli.measure import trained
from humoslope.deploy.contract import FILE
from humoslope.env import ManagerBasedRlEnv
from humoslope.evaluation.ramps import RampProtocol, ramp_env_cfg
from humoslope.export.folder import DEPLOY, MODEL, ONNX
from humoslope.export.policy import export, record_observations
from humoslope.files import check_place
from humoslope.learning.policy import load_actor, read_spec

WALK = RampProtocol(grades=(0.0, 20.0, -20.0), starts=2, seconds=2.0)
"""Walks on whose observations the exported network is compared with the actor."""


@dataclasses.dataclass(frozen=True)
class Options:
    """Exports a trained policy: its network as ONNX, a contract with all that is needed to run it, the robot's model,
    and a deploy.yaml for Unitree RL Lab's deployment.

    Attributes:
        checkpoint: Path of a checkpoint; a run folder stands for its newest one.
        out: Path of the folder to write into; by default beside the checkpoint.
    """

    checkpoint: tyro.conf.Positional[Path]
    out: Path | None = None


def run(arguments: list[str]) -> None:
    """Exports the checkpoint named in `arguments`."""
    options = tyro.cli(Options, args=arguments, prog="humoslope export")
    provenance, task = trained(options.checkpoint)
    folder = options.out or provenance.path.with_suffix(".export")
    for file in (FILE, MODEL, ONNX, DEPLOY):
        check_place(folder / file)

    console = Console()
    console.print(f"{provenance.name}, iteration {provenance.iteration}: walking, translating", soft_wrap=True)
    env = ManagerBasedRlEnv(ramp_env_cfg(task.env, WALK, read_spec(provenance.path).groups))
    actor = load_actor(provenance.path, env, provenance.task)
    result = export(actor, env, task.env, record_observations(env, actor, WALK.seconds), folder)
    network = result.contract.network
    inputs = " and ".join("x".join(map(str, end.shape[1:])) for end in network.inputs)
    files = [FILE, MODEL, ONNX] if result.without_deploy_yaml else [FILE, MODEL, ONNX, DEPLOY]
    console.print(
        f"ONNX {inputs} -> {network.output.shape[1]}; at most {result.difference:.1g} from torch over "
        f"{result.compared} observations of a walk\n{provenance.training}\n"
        f"wrote {folder}: {', '.join(files)}",
        soft_wrap=True,
        highlight=False,
    )
    if result.without_deploy_yaml:
        console.print(f"no {DEPLOY}: {result.without_deploy_yaml}", soft_wrap=True, highlight=False)
