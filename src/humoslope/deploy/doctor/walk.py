"""The walking part of a rollout, and what a check found in it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from humoslope.deploy.contract import Contract
from humoslope.deploy.onboard.log import contract_sha256
from humoslope.deploy.quantities import Array
from humoslope.errors import UserError
from humoslope.replay.rollout import Rollout, load_rollout

SHORTEST = 50
"""Smallest number of control steps that a diagnosis needs."""


@dataclass(frozen=True)
class Finding:
    """Result of a check.

    Attributes:
        check: What was checked.
        wrong: True if something is out.
        words: What was found, with its figure.
    """

    check: str
    wrong: bool
    words: str


@dataclass(frozen=True)
class Walk:
    """T control steps of a walk. In step k the policy saw `quat_w[k]` and the others and was commanded `command[k]`;
    then it gave `action[k]`, and the motors were sent `target[k]`.

    Attributes:
        quat_w: [T, 4] orientation, w first.
        ang_vel_b: [T, 3] angular velocity, rad/s.
        joint_pos: [T, J] positions, rad.
        joint_vel: [T, J] velocities, rad/s.
        torque: [T, J] torques, Nm.
        command: [T, 3] command.
        action: [T, J] output of the network.
        target: [T, J] targets, rad.
    """

    quat_w: Array
    ang_vel_b: Array
    joint_pos: Array
    joint_vel: Array
    torque: Array
    command: Array
    action: Array
    target: Array

    def __len__(self) -> int:
        return len(self.action)


def read_walk(path: Path, folder: Path, contract: Contract) -> Walk:
    """Reads the walking part of a rollout, of `humoslope deploy` or another recording of the same policy.

    Raises:
        UserError: If the file is no rollout, of another policy or contract, too short, or does not hold what the policy
            saw.
    """
    rollout = load_rollout(path)
    _check_origin(path, rollout, folder, contract)
    with np.load(path, allow_pickle=False) as archive:
        mode = archive["mode"] if "mode" in archive.files else None
        sent = archive["target"] if "target" in archive.files else None
    columns = rollout.columns
    steps = np.arange(len(columns))
    if mode is not None:
        steps = steps[mode == "WALK"]
    # A row holds what was measured after its action: the policy saw the row before.
    steps = steps[steps > 0]
    first_episode = columns.episode[steps] == columns.episode[steps[0]] if len(steps) else []
    steps = steps[first_episode]
    if len(steps) < SHORTEST:
        raise UserError(f"rollout '{path}' holds {len(steps)} steps of walking; a diagnosis needs {SHORTEST}.")

    def taken(values: NDArray[np.generic], rows: NDArray[np.int64]) -> Array:
        return np.asarray(values[rows], dtype=np.float64)

    default = np.array([joint.default_rad for joint in contract.joints])
    scale = np.array([joint.action_scale_rad for joint in contract.joints])
    action = taken(columns.action, steps)
    return Walk(
        quat_w=taken(columns.root_quat_w, steps - 1),
        ang_vel_b=taken(columns.root_ang_vel_b, steps - 1),
        joint_pos=taken(columns.joint_pos, steps - 1),
        joint_vel=taken(columns.joint_vel, steps - 1),
        torque=taken(columns.joint_torque, steps - 1),
        command=taken(columns.command, steps),
        action=action,
        target=default + scale * action if sent is None else taken(sent, steps),
    )


def _check_origin(path: Path, rollout: Rollout, folder: Path, contract: Contract) -> None:
    protocol = rollout.header.get("protocol")
    known = protocol.get("contract_sha256") if isinstance(protocol, dict) else None
    if known is not None and known != contract_sha256(folder):
        raise UserError(f"rollout '{path}' was recorded with another contract than the one in '{folder}'.")
    if rollout.header["checkpoint"]["sha256"] != contract.training.sha256:
        raise UserError(f"rollout '{path}' is a walk of another checkpoint than the one that '{folder}' exports.")
    # `humoslope record` keeps the state of the last physics step, and not what was measured.
    kept_s, seen_s = contract.timing.physics_step_s, contract.timing.observation_age_s
    if known is None and seen_s > kept_s * (1.0 + 1e-6):
        raise UserError(
            f"rollout '{path}' shows the robot {1e3 * kept_s:g} ms before each step, and the policy saw it "
            f"{1e3 * seen_s:g} ms before; only a recording of `humoslope deploy` holds what it saw."
        )
    if rollout.joint_names != [joint.name for joint in contract.joints]:
        raise UserError(f"rollout '{path}' lists other joints, or in another order, than the contract in '{folder}'.")
