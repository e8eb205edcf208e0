"""All checks of a recorded walk, in the order in which their findings are to be believed."""

from __future__ import annotations

from pathlib import Path

from humoslope.deploy.contract import Contract
from humoslope.deploy.controller import OnnxPolicy
from humoslope.deploy.doctor import imu, motors, network
from humoslope.deploy.doctor.walk import Finding, read_walk
from humoslope.deploy.onboard.kinematics import Kinematics


def diagnose(log: Path, folder: Path, contract: Contract, policy: OnnxPolicy) -> list[Finding]:
    """Returns what every check found.

    Args:
        log: The rollout.
        folder: The export folder.
        contract: The contract in it.
        policy: The network in it.

    Raises:
        UserError: If the rollout cannot be used with the contract.
    """
    walk = read_walk(log, folder, contract)
    return [
        network.check(walk, contract, policy),
        *motors.check(walk, contract),
        *imu.check(walk, contract, folder, Kinematics(folder, contract)),
    ]
