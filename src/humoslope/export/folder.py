"""Files of an export folder, and what any robot contributes to them."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import humoslope
from humoslope.deploy import contract as contracts
from humoslope.deploy.contract import (
    Action,
    Contract,
    Joint,
    Network,
    NetworkInput,
    NetworkOutput,
    ObservationGroup,
    RobotModel,
    Steering,
    Term,
)
from humoslope.deploy.quantities import QUANTITIES
from humoslope.deploy.unitree import deploy_yaml
from humoslope.errors import UserError
from humoslope.files import write_atomically, write_text
from humoslope.provenance import git_state
from humoslope.scene.robot import Robot
from humoslope.seal import SUMS, write_sums

# Paths at which Unitree's deployment looks for them in a policy folder.
ONNX, DEPLOY = "exported/policy.onnx", "params/deploy.yaml"
MODEL = "model.xml"

CONVENTIONS = (
    "SI units: m, s, rad, kg, N, Nm; degrees where a name ends in _deg. Right-handed frames, x forward, y left, z up; "
    "quaternions w first. Joints, actions, and observations of one number for each joint are in the order of 'joints'."
)
ACTION = Action(
    target="default_rad + action_scale_rad * output",
    torque="stiffness_nm_rad * (target - position) - damping_nms_rad * velocity, within +-effort_limit_nm",
)
OUTPUT = "actions"
"""Name of the network's output, as Unitree's deployment has it."""


def write_export(folder: Path, contract: Contract, network: bytes, model: str) -> str | None:
    """Writes an export; the list of checksums last, so that a folder with one is complete.

    Args:
        folder: Folder to write into.
        contract: The contract.
        network: The ONNX file.
        model: The robot model.

    Returns:
        Reason why no deploy.yaml was written for Unitree's deployment; None if it was.
    """
    (folder / SUMS).unlink(missing_ok=True)  # of an earlier export, of which the files are replaced one by one
    write_atomically(folder / ONNX, lambda path: path.write_bytes(network))
    write_text(folder / MODEL, model)
    try:
        write_text(folder / DEPLOY, deploy_yaml(contract))
        without = None
    except UserError as error:
        (folder / DEPLOY).unlink(missing_ok=True)  # of an earlier export
        without = str(error)
    write_text(folder / contracts.FILE, contract.to_json())
    write_sums(folder, [ONNX, MODEL, contracts.FILE, *([] if without else [DEPLOY])])
    return without


def metadata(joints: tuple[Joint, ...], groups: tuple[ObservationGroup, ...], run_path: str) -> dict[str, str]:
    """Returns what a program that knows no contract needs to run a network, under mjlab's keys; lists are separated by
    commas.

    `observation_history`, the control steps that each observation spans, is ours, and older than mjlab's own key. mjlab
    writes three decimals, this every digit.

    Args:
        joints: Joints in the order of actions and observations.
        groups: Observation groups in the order of the network's inputs.
        run_path: File of the policy.
    """
    history = [group.history for group in groups for _ in group.terms]
    lists: dict[str, list[Any]] = {
        "joint_names": [joint.name for joint in joints],
        "joint_stiffness": [joint.stiffness_nm_rad for joint in joints],
        "joint_damping": [joint.damping_nms_rad for joint in joints],
        "default_joint_pos": [joint.default_rad for joint in joints],
        "action_scale": [joint.action_scale_rad for joint in joints],
        "command_names": ["velocity"],
        "observation_names": [term.name for group in groups for term in group.terms],
        "observation_terms_scale": [term.scale for group in groups for term in group.terms],
        "observation_terms_history_length": history,
        "observation_history": history,
    }
    return {"run_path": run_path} | {name: ",".join(map(str, values)) for name, values in lists.items()}


def model_xml(robot: Robot, timestep: float, cone: int) -> str:
    """Returns the robot alone as MJCF with these physics options; actuators and sensors are in the contract.

    MuJoCo writes six digits.

    Args:
        robot: The robot.
        timestep: Physics step, s.
        cone: MuJoCo's number of the friction cone.

    Raises:
        UserError: If the robot needs other files.
    """
    spec = robot.make_spec()
    if spec.meshes:
        raise UserError(f"{robot.name}: its model needs mesh files, which an export does not carry.")
    # The reader builds actuators from the contract's numbers; keyframes with controls would not match without them.
    for part in (*spec.actuators, *spec.sensors, *spec.keys):
        spec.delete(part)
    spec.option.timestep = timestep
    spec.option.cone = cone
    spec.compile()
    return spec.to_xml()


def joints_of(robot: Robot, model: Any, scale_factor: float = 1.0) -> tuple[Joint, ...]:
    """Returns the joints of a robot as a contract lists them.

    Args:
        robot: The robot.
        model: A compiled MuJoCo model with it.
        scale_factor: Factor on its action scales.
    """
    return tuple(
        Joint(
            name=name,
            default_rad=robot.default_joint_pos[i],
            action_scale_rad=robot.action_scale[i] * scale_factor,
            stiffness_nm_rad=robot.stiffness[i],
            damping_nms_rad=robot.damping[i],
            effort_limit_nm=robot.effort_limit[i],
            armature_kg_m2=float(model.dof_armature[model.joint(name).dofadr[0]]),
            range_rad=(float(model.joint(name).range[0]), float(model.joint(name).range[1])),
        )
        for i, name in enumerate(robot.joint_names)
    )


def described(quantity: str, robot: Robot, *, name: str, scale: float, training_noise: float) -> Term:
    """Returns a term of one of `QUANTITIES`, in words.

    Args:
        quantity: Name of the quantity.
        robot: The robot, for one component for each joint.
        name: Name of the term.
        scale: Factor on every component.
        training_noise: Half-width of the uniform noise in training.
    """
    known = QUANTITIES[quantity]
    components = known.components or robot.joint_names
    return Term(
        name=name,
        quantity=quantity,
        meaning=known.meaning,
        frame=known.frame,
        unit=known.unit,
        components=components,
        shape=(len(components),),
        scale=scale,
        training_noise=training_noise,
    )


def network_of(content: bytes, inputs: tuple[NetworkInput, ...], joints: int) -> Network:
    """Returns the description of a network whose output is an action for so many joints."""
    output = NetworkOutput(OUTPUT, (1, joints))
    return Network(file=ONNX, sha256=hashlib.sha256(content).hexdigest(), inputs=inputs, output=output)


def robot_model(robot: Robot, model: str) -> RobotModel:
    """Returns the description of a robot whose model, as MJCF, lies in the export."""
    return RobotModel(
        name=robot.name,
        file=MODEL,
        sha256=hashlib.sha256(model.encode("utf-8")).hexdigest(),
        root_body=robot.root_body,
        foot_geoms=tuple(geom for side in robot.foot_geoms for geom in side),
        default_root_height_m=robot.default_root_height,
    )


def steering(heading_gain: float, lateral_gain: float, limit: float) -> Steering:
    """Returns the law by which a robot is kept on its course, with these gains, 1/s and rad/m, and limit, rad/s."""
    return Steering(
        law="clamp(heading_gain_per_s * wrap(-lateral_gain_rad_m * place_left_of_course - yaw), +-limit_rad_s)",
        heading_gain_per_s=heading_gain,
        lateral_gain_rad_m=lateral_gain,
        limit_rad_s=limit,
    )


def exporter() -> str:
    """Returns version and commit of this code."""
    return f"humoslope {humoslope.__version__}, {git_state().splitlines()[0]}"
