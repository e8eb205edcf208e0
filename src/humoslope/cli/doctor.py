"""`humoslope doctor DIR LOG`: what is wrong, told from a recorded walk."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import tyro
from rich.console import Console
from rich.table import Table

from humoslope.deploy import contract as contracts
from humoslope.deploy.controller import OnnxPolicy
from humoslope.deploy.doctor import diagnose


@dataclasses.dataclass(frozen=True)
class Options:
    """Finds out from a recorded walk what differs from the contract: observations, delay, encoders, gains, IMU.

    Attributes:
        folder: Folder that `humoslope export` wrote.
        log: Rollout that `humoslope deploy` recorded; another recording of the same policy will do if it holds what the
            policy saw.
    """

    folder: tyro.conf.Positional[Path]
    log: tyro.conf.Positional[Path]


def run(arguments: list[str]) -> None:
    """Examines the walk named in `arguments`."""
    options, console = tyro.cli(Options, args=arguments, prog="humoslope doctor"), Console()
    folder = contracts.located(options.folder)
    contract = contracts.read(folder)
    findings = diagnose.diagnose(options.log, folder, contract, OnnxPolicy(folder, contract.network))
    table = Table("", "check", "finding")
    for finding in findings:
        table.add_row("[red]out[/red]" if finding.wrong else "ok", finding.check, finding.words)
    console.print(table)
    wrong = [finding.check for finding in findings if finding.wrong]
    verdict = f"Look first at: {wrong[0]}." if wrong else "Nothing is out."
    console.print(verdict, highlight=False, soft_wrap=True)
