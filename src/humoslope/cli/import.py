"""`humoslope import SOURCE`: a policy that was trained elsewhere, as an export that every verb takes."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import tyro
from rich.console import Console

from humoslope.deploy.contract import FILE
from humoslope.export.folder import DEPLOY, MODEL, ONNX
from humoslope.files import check_place
from humoslope.foreign import folder as folders
from humoslope.foreign.source import choose_robot, find
from humoslope.registry import load_content


@dataclasses.dataclass(frozen=True)
class Options:
    """Makes an export of a policy that was trained elsewhere, for `play`, `evaluate`, `ramps`, `margins` and others.

    Its format shows in the file: an ONNX network with the metadata of mjlab or of holosoma, or Unitree's deploy.yaml
    with a policy.onnx. A published policy is fetched by its name, such as holosoma-ppo or holosoma-fastsac, and checked
    by its hash.

    Attributes:
        source: An ONNX file, a deploy.yaml, a folder with one, or the name of a published policy.
        out: Folder to write into; by default one in the working folder with the name of the policy.
        robot: Name of the robot that it is to walk on; not needed while all tasks have the same.
        network: Path of the network of a deploy.yaml; by default where Unitree's training leaves it.
    """

    source: tyro.conf.Positional[str]
    out: Path | None = None
    robot: str | None = None
    network: Path | None = None


def run(arguments: list[str]) -> None:
    """Imports the policy named in `arguments`."""
    options, console = tyro.cli(Options, args=arguments, prog="humoslope import"), Console()
    load_content()
    robot = choose_robot(options.robot)
    found = find(options.source, options.network, robot)
    folder = options.out or Path(found.source.name)
    for file in (FILE, MODEL, ONNX, DEPLOY):
        check_place(folder / file)
    contract = folders.write(folder, found.policy, found.network, robot, found.source)
    (group,), (end,) = contract.observations, contract.network.inputs
    history = f" of {group.history} steps" if group.history > 1 else ""
    console.print(
        f"{contract.training.title}, on {contract.robot.name}: {len(group.terms)} observations{history}, "
        f"{end.shape[1]} numbers -> {len(contract.joints)} joints at {1.0 / contract.timing.control_step_s:g} Hz\n"
        + "".join(f"{sentence}\n" for sentence in found.about)
        + f"wrote {folder}; humoslope play {folder}",
        soft_wrap=True,
        highlight=False,
        markup=False,
    )
