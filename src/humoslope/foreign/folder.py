"""The export folder of a policy from outside: our robot with the policy's gains, and a contract."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import Commands, Contract, Fall, NetworkInput, ObservationGroup, Timing, Training
from humoslope.errors import UserError, unknown
from humoslope.export.folder import (
    ACTION,
    CONVENTIONS,
    described,
    exporter,
    joints_of,
    metadata,
    model_xml,
    network_of,
    robot_model,
    steering,
    write_export,
)
from humoslope.export.onnx import with_metadata
from humoslope.foreign.policy import ForeignPolicy
from humoslope.foreign.rewire import INPUT, common_scale, rewired
from humoslope.managers import VelocityCommandCfg
from humoslope.scene.redriven import redriven
from humoslope.scene.robot import Robot

GROUP = "actor"
FALL = Fall(root_height_below_m=0.4, tilt_above_deg=55.0)
"""What a fall is; as in the ramp check."""
ASSUMED = ((-1.0, 1.0), (-1.0, 1.0), (-1.0, 1.0))
"""Commands for a policy whose file does not say its own, m/s, m/s and rad/s."""


@dataclass(frozen=True)
class Source:
    """Origin of a policy.

    Attributes:
        name: Name that it is called by.
        path: File of its network, for messages and for its name.
        sha256: SHA-256 of that file, hexadecimal.
        origin: Where it was trained, for people.
    """

    name: str
    path: Path
    sha256: str
    origin: str


def write(folder: Path, policy: ForeignPolicy, network: Any, robot: Robot, source: Source) -> Contract:
    """Writes the export of a policy from outside, and returns its contract.

    Args:
        folder: Folder to write into.
        policy: Its description.
        network: Its network, as `rewire.load` returns it.
        robot: Robot that it walks on.
        source: Its origin.

    Raises:
        UserError: If the policy does not fit the robot, or contradicts itself.
    """
    policy.check(source.path)
    _check_joints(policy, robot, source.path)
    walker = robot_of(policy, robot)
    compiled = walker.make_spec().compile()
    joints = joints_of(walker, compiled)
    groups = (
        ObservationGroup(
            name=GROUP,
            history=max(term.history for term in policy.terms),
            layout="terms in this order; of each term all frames, oldest first",
            start="all frames equal the first one",
            terms=tuple(
                described(term.quantity, walker, name=term.name, scale=common_scale(term), training_noise=0.0)
                for term in policy.terms
            ),
        ),
    )
    content = rewired(network, policy, walker.joint_names, str(source.path))
    content = with_metadata(content, metadata(joints, groups, source.path.name))
    model = model_xml(walker, compiled.opt.timestep, compiled.opt.cone)
    contract = Contract(
        format="humoslope-policy",
        version=2,
        exported_by=exporter(),
        conventions=CONVENTIONS,
        training=Training(source.name, source.path.name, source.sha256, None, None, None, None, source.origin),
        network=network_of(content, (NetworkInput(INPUT, GROUP, groups[0].shape),), len(joints)),
        robot=robot_model(walker, model),
        timing=Timing(policy.control_step_s, compiled.opt.timestep, compiled.opt.timestep),
        action=ACTION,
        joints=joints,
        observations=groups,
        commands=_commands(policy),
        fall=FALL,
        gait_clock=policy.gait_clock,
    )
    contracts.check(contract)
    write_export(folder, contract, content, model)
    return contract


def robot_of(policy: ForeignPolicy, robot: Robot) -> Robot:
    """Returns the robot with the gains, the action scale and the default pose of a policy."""

    def ours(values: tuple[float, ...]) -> tuple[float, ...]:
        by_name = dict(zip(policy.joints, values, strict=True))
        return tuple(by_name[name] for name in robot.joint_names)

    return redriven(
        robot, ours(policy.default), ours(policy.action_scale), ours(policy.stiffness), ours(policy.damping)
    )


def _check_joints(policy: ForeignPolicy, robot: Robot, path: Path) -> None:
    for name in policy.joints:
        if name not in robot.joint_names:
            raise UserError(f"'{path}': {unknown(f'joint of {robot.name}', name, robot.joint_names)}")
    if len(set(policy.joints)) < len(policy.joints):
        raise UserError(f"'{path}' lists a joint twice.")
    if missing := [name for name in robot.joint_names if name not in policy.joints]:
        raise UserError(
            f"'{path}' moves {len(policy.joints)} joints, and {robot.name} has {robot.num_joints}: "
            f"it lacks '{missing[0]}'."
        )


def _commands(policy: ForeignPolicy) -> Commands:
    forward, left, turn = ranges = policy.commands or ASSUMED
    own = VelocityCommandCfg()
    return Commands(
        forward_m_s=forward,
        left_m_s=left,
        yaw_rate_rad_s=turn,
        trained_to_stand=all(low <= 0.0 <= high for low, high in ranges),
        held_s=own.resample_s,
        steering=steering(own.heading_gain, own.lateral_gain, own.yaw_rate_limit),
    )
