"""The contract of an exported policy: everything needed to run its network on the robot it was trained for.

It is written as `policy.json`, every number at full precision. `humoslope play` reads only this file, and the network
and the robot model that it names.

Version 2 lists the network's inputs, one for each observation group, of any shape; version 1 had a single vector. The
reader brings a contract of version 1 to version 2.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal

from humoslope.deploy.quantities import CUSTOM, FEET, GAIT_PHASE, QUANTITIES
from humoslope.deploy.typed_json import typed
from humoslope.errors import UserError, unknown
from humoslope.seal import check_sums
from humoslope.shipped import found

FILE = "policy.json"
VERSION = 2
"""Increased when the meaning of anything that an older reader uses changes."""
LONGEST_STEP_S = 1.0
"""Longest control step that is taken for one, s."""
LONGEST_AGE_S = 0.2
"""Longest age of an observation that is taken for one, s; no robot that walks is controlled so late."""

Range = tuple[float, float]


@dataclass(frozen=True)
class Training:
    """Origin of the policy; not needed to run it.

    Attributes:
        task: Registered name of the task; of a policy from outside, its name.
        checkpoint: File name of the checkpoint; of a policy from outside, of its network.
        sha256: SHA-256 of that file, hexadecimal.
        iteration: Number of training iterations before the checkpoint; null if that is not known.
        environment_steps: Number of control steps, summed over all environments; null if that is not known.
        harness: Scale in [0, 1] of the training harness at the end; null if there was none.
        started_from: Training that this one continued from; null if it started from random weights.
        origin: Where it was trained, if not with HumoSlope; else empty.
    """

    task: str
    checkpoint: str
    sha256: str
    iteration: int | None
    environment_steps: int | None
    harness: float | None
    started_from: Training | None
    origin: str = ""

    @property
    def title(self) -> str:
        """The policy in a few words, such as "HumoSlope-Stage1-Unitree-G1, iteration 2969"."""
        return f"{self.task}, {self.origin or f'iteration {self.iteration}'}"


@dataclass(frozen=True)
class NetworkInput:
    """One input of the network.

    Attributes:
        name: Name of the input in the ONNX file.
        group: Name of the observation group that it takes, one of `Contract.observations`.
        shape: Shape of the input, [1, ...].
    """

    name: str
    group: str
    shape: tuple[int, ...]


@dataclass(frozen=True)
class NetworkOutput:
    """The output of the network, the action.

    Attributes:
        name: Name of the output in the ONNX file.
        shape: Shape of the output, [1, joints].
    """

    name: str
    shape: tuple[int, ...]


@dataclass(frozen=True)
class Network:
    """The policy as ONNX, float32, batch size 1, with its observation normaliser inside.

    Attributes:
        file: Path of the ONNX file relative to the contract.
        sha256: SHA-256 of the ONNX file, hexadecimal.
        inputs: Inputs, one for each observation group.
        output: The action.
    """

    file: str
    sha256: str
    inputs: tuple[NetworkInput, ...]
    output: NetworkOutput


@dataclass(frozen=True)
class RobotModel:
    """The robot as MJCF without ground, actuators and sensors; its `<option>` holds the physics of the evaluation.

    Attributes:
        name: Name of the robot.
        file: Path of the model relative to the contract.
        sha256: SHA-256 of the model, hexadecimal; null in a contract of version 1.
        root_body: Body with the free joint, in whose frame observations are given.
        foot_geoms: Geoms with which the feet touch the ground; their friction is the contact's.
        default_root_height_m: Height of the root above the ground in the default pose.
    """

    name: str
    file: str
    sha256: str | None
    root_body: str
    foot_geoms: tuple[str, ...]
    default_root_height_m: float


@dataclass(frozen=True)
class Timing:
    """Control and physics steps.

    Attributes:
        control_step_s: Period at which the network runs; its targets are held in between.
        physics_step_s: Physics step of the evaluation.
        observation_age_s: Age of what encoders and IMU say at the moment when the action that answers it takes effect;
            at least one physics step.
    """

    control_step_s: float
    physics_step_s: float
    observation_age_s: float


@dataclass(frozen=True)
class Action:
    """Meaning of the network's output. Neither the output nor the target is clipped."""

    target: Literal["default_rad + action_scale_rad * output"]
    torque: Literal["stiffness_nm_rad * (target - position) - damping_nms_rad * velocity, within +-effort_limit_nm"]


@dataclass(frozen=True)
class Joint:
    """A joint; joints are listed in the order of actions and observations.

    Attributes:
        name: Name of the joint in the robot model.
        default_rad: Target position for an action of zero.
        action_scale_rad: Change of the target position for one unit of action.
        stiffness_nm_rad: Proportional gain of the position control.
        damping_nms_rad: Derivative gain of the position control.
        effort_limit_nm: Largest torque.
        armature_kg_m2: Rotor inertia as seen at the joint.
        range_rad: Lowest and highest position.
    """

    name: str
    default_rad: float
    action_scale_rad: float
    stiffness_nm_rad: float
    damping_nms_rad: float
    effort_limit_nm: float
    armature_kg_m2: float
    range_rad: Range


@dataclass(frozen=True)
class Term:
    """A part of an observation group: `scale` times a quantity.

    Attributes:
        name: Name of the term in the task.
        quantity: One of `humoslope.deploy.quantities`, or "custom" for anything else. `humoslope play` cannot compute a
            custom quantity; a program that can may run the policy.
        meaning: Description of the quantity.
        frame: Reference frame of the quantity; empty if it has none.
        unit: Unit of all components, or one for each component; empty if the quantity is custom.
        components: Names of the components in order; empty if the quantity is custom.
        shape: Shape of one frame.
        scale: Factor on every component.
        training_noise: Half-width of the uniform noise in training, before the scale.
    """

    name: str
    quantity: str
    meaning: str
    frame: str
    unit: tuple[str, ...]
    components: tuple[str, ...]
    shape: tuple[int, ...]
    scale: float
    training_noise: float


@dataclass(frozen=True)
class ObservationGroup:
    """Composition of one input of the network.

    Attributes:
        name: Name of the group in the task.
        history: Number of control steps that it spans.
        layout: Order of terms and frames, along the first axis of their shape.
        start: Content of the history after a reset.
        terms: Terms in order.
    """

    name: str
    history: int
    layout: Literal["terms in this order; of each term all frames, oldest first"]
    start: Literal["all frames equal the first one"]
    terms: tuple[Term, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the group, [1, ...].

        Raises:
            UserError: If its terms cannot be concatenated.
        """
        shapes = [term.shape for term in self.terms]
        rest = shapes[0][1:]
        if any(len(shape) < 1 or min(shape) < 1 or shape[1:] != rest for shape in shapes):
            listed = ", ".join(str(list(shape)) for shape in shapes)
            raise UserError(f"group '{self.name}': terms of the shapes {listed} cannot be concatenated.")
        return 1, self.history * sum(shape[0] for shape in shapes), *rest


@dataclass(frozen=True)
class Steering:
    """Law of the yaw rates commanded to keep a straight course; `wrap` brings an angle into +-pi."""

    law: Literal["clamp(heading_gain_per_s * wrap(-lateral_gain_rad_m * place_left_of_course - yaw), +-limit_rad_s)"]
    heading_gain_per_s: float
    lateral_gain_rad_m: float
    limit_rad_s: float


@dataclass(frozen=True)
class Commands:
    """Commands that the policy was trained with.

    Attributes:
        forward_m_s: Range of the forward speed along the ground.
        left_m_s: Range of the lateral speed along the ground.
        yaw_rate_rad_s: Range of the yaw rate; turning left is positive.
        trained_to_stand: Whether commands to stand (all zero) were part of the training, in addition to the ranges.
            It does not say that the robot then stands still; `humoslope play DIR --headless --speed 0` measures that.
        held_s: Shortest and longest time between changes.
        steering: Source of some of the yaw rates; a joystick may replace it.
    """

    forward_m_s: Range
    left_m_s: Range
    yaw_rate_rad_s: Range
    trained_to_stand: bool
    held_s: Range
    steering: Steering


@dataclass(frozen=True)
class Fall:
    """Definition of a fall in training and evaluation; null for a limit that was not used.

    Attributes:
        root_height_below_m: Smallest height of the root above the ground.
        tilt_above_deg: Largest angle between the root's z axis and the vertical.
    """

    root_height_below_m: float | None
    tilt_above_deg: float | None


@dataclass(frozen=True)
class GaitClock:
    """Clock of a gait, which a policy sees as phases of the feet.

    While the robot is commanded to move, each phase grows by 2 pi in a period; at the first control step of a motion,
    also after a rest, it is the foot's offset. At rest every phase is pi.

    Attributes:
        period_s: Duration of a gait cycle.
        offsets_rad: Phases of the left and the right foot at the first step of a motion.
        rest_below: The robot is at rest while the commanded speed, m/s, and the size of the yaw rate, rad/s, are both
            below this.
    """

    period_s: float
    offsets_rad: tuple[float, ...]
    rest_below: float


@dataclass(frozen=True)
class Contract:
    """Contract of an exported policy; see the module.

    Attributes:
        format: Identifies the file.
        version: Version of the format.
        exported_by: Version and commit of the code that wrote it.
        conventions: Units, frames and orders that hold throughout.
        training: Origin of the policy.
        network: The policy's network.
        robot: The robot model.
        timing: Control and physics steps.
        action: Meaning of the network's output.
        joints: Joints in the order of actions and observations.
        observations: Observation groups in the order of the network's inputs.
        commands: Commands that the policy was trained with.
        fall: Definition of a fall.
        gait_clock: Clock that the policy sees; null if it sees none.
    """

    format: Literal["humoslope-policy"]
    version: Literal[2]
    exported_by: str
    conventions: str
    training: Training
    network: Network
    robot: RobotModel
    timing: Timing
    action: Action
    joints: tuple[Joint, ...]
    observations: tuple[ObservationGroup, ...]
    commands: Commands
    fall: Fall
    gait_clock: GaitClock | None = None

    @property
    def decimation(self) -> int:
        """Number of physics steps in a control step."""
        return round(self.timing.control_step_s / self.timing.physics_step_s)

    def to_json(self) -> str:
        """The contract as JSON, with values on one line where they fit."""
        return _pretty(_written(self), "") + "\n"


def located(folder: Path) -> Path:
    """`folder`; or, where it holds no contract, the export of that name that comes with HumoSlope."""
    return found(folder / FILE).parent


def read(folder: Path) -> Contract:
    """Reads the contract in an export folder, of this version or an older one.

    Raises:
        UserError: If there is none, or it is broken, foreign, newer, or contradicts itself.
    """
    path = folder / FILE
    if not folder.is_dir():
        raise UserError(f"export folder '{folder}' does not exist; `humoslope export CHECKPOINT` writes one.")
    if not path.is_file():
        raise UserError(f"'{folder}' holds no {FILE}; `humoslope export CHECKPOINT` writes one.")
    try:
        raw = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError, RecursionError) as error:
        raise UserError(f"contract '{path}' cannot be read: {error}.") from None
    if not isinstance(raw, dict) or raw.get("format") != "humoslope-policy":
        raise UserError(f"'{path}' is not the contract of a HumoSlope policy.")
    version = raw.get("version")
    if version not in (1, VERSION):
        raise UserError(f"contract '{path}' has version {version}; this program reads versions 1 to {VERSION}.")
    try:
        contract = typed(Contract, _from_version_1(raw) if version == 1 else raw)
        check(contract)
    except UserError as error:
        raise UserError(f"contract '{path}': {error}") from None
    except RecursionError:
        raise UserError(f"contract '{path}' cannot be read: it is nested too deeply.") from None
    check_sums(folder)
    return contract


def _from_version_1(raw: dict[str, Any]) -> dict[str, Any]:
    """A contract of version 1, as `json` reads it, in the form of version 2.

    Raises:
        UserError: If it lacks what version 1 has.
    """
    raw = dict(raw)
    try:
        network, observation, commands = dict(raw["network"]), dict(raw.pop("observation")), dict(raw["commands"])
        shape, group = [1, network["inputs"]], "actor"
        network["inputs"] = [{"name": network.pop("input"), "group": group, "shape": shape}]
        network["output"] = {"name": network["output"], "shape": [1, network.pop("outputs")]}
        observation["terms"] = [term | {"shape": [len(term["components"])]} for term in observation["terms"]]
        commands["trained_to_stand"] = commands.pop("stands")
        robot = raw["robot"] | {"sha256": None}
    except KeyError as error:
        raise UserError(f"field {error} is missing.") from None
    except (TypeError, ValueError):
        raise UserError("its fields are not those of a contract of version 1.") from None
    observations = [{"name": group, **observation}]
    changed = {"network": network, "robot": robot, "observations": observations, "commands": commands}
    return raw | changed | {"version": VERSION}


def _written(value: Any) -> Any:
    """A contract as `json` writes it. A field that was added later is left out while it has its default, so that an
    older reader of the same version takes what needs no more than it knows."""
    if is_dataclass(value):
        known = ((field, getattr(value, field.name)) for field in fields(value))
        return {f.name: _written(v) for f, v in known if f.default is MISSING or v != f.default}
    return [_written(item) for item in value] if isinstance(value, tuple) else value


def check(contract: Contract) -> None:
    """Raises UserError where values make no sense or parts do not fit together; `read` does so as well."""
    joints, timing, robot, network = contract.joints, contract.timing, contract.robot, contract.network
    if min(timing.control_step_s, timing.physics_step_s) <= 0.0 or contract.decimation < 1:
        raise UserError("timing: a step must be positive, and the physics step no longer than the control step.")
    if timing.control_step_s > LONGEST_STEP_S:
        raise UserError(f"timing: control_step_s {timing.control_step_s:g} must be at most {LONGEST_STEP_S:g}.")
    if abs(contract.decimation * timing.physics_step_s - timing.control_step_s) > 1e-9:
        raise UserError("timing: the control step must be a whole number of physics steps.")
    if not timing.physics_step_s - 1e-9 <= timing.observation_age_s <= LONGEST_AGE_S:
        raise UserError(
            f"timing: observation_age_s {timing.observation_age_s:g} must be at least one physics step, "
            f"{timing.physics_step_s:g}, and at most {LONGEST_AGE_S:g}."
        )
    if robot.default_root_height_m <= 0.0:
        raise UserError(f"robot: default_root_height_m {robot.default_root_height_m:g} must be positive.")
    if list(network.output.shape) != [1, len(joints)]:
        raise UserError(f"the network's output has shape {list(network.output.shape)} for {len(joints)} joints.")
    _check_unique("two joints", (joint.name for joint in joints))
    for joint in joints:
        _check_joint(joint)
    for kind, (low, high) in (
        ("forward_m_s", contract.commands.forward_m_s),
        ("left_m_s", contract.commands.left_m_s),
        ("yaw_rate_rad_s", contract.commands.yaw_rate_rad_s),
    ):
        if low > high:
            raise UserError(f"commands: {kind} [{low:g}, {high:g}] must be lowest first.")
    clock = contract.gait_clock
    if clock is not None and not (clock.period_s > 0.0 and len(clock.offsets_rad) == len(FEET)):
        raise UserError("gait_clock: its period must be positive, and there must be an offset for each of two feet.")
    _check_observations(contract)


def _check_joint(joint: Joint) -> None:
    for name in ("stiffness_nm_rad", "damping_nms_rad", "armature_kg_m2"):
        if getattr(joint, name) < 0.0:
            raise UserError(f"joint '{joint.name}': {name} {getattr(joint, name):g} must be 0 or more.")
    if joint.effort_limit_nm <= 0.0:
        raise UserError(f"joint '{joint.name}': effort_limit_nm {joint.effort_limit_nm:g} must be positive.")
    low, high = joint.range_rad
    if low > high:
        raise UserError(f"joint '{joint.name}': range_rad [{low:g}, {high:g}] must be lowest first.")


def _check_observations(contract: Contract) -> None:
    groups, inputs = contract.observations, contract.network.inputs
    _check_unique("two observation groups", (group.name for group in groups))
    ends = [*(end.name for end in inputs), contract.network.output.name]
    _check_unique("network: two inputs or outputs", ends)
    if [end.group for end in inputs] != [group.name for group in groups]:
        taken, given = (", ".join(names) for names in ([e.group for e in inputs], [g.name for g in groups]))
        raise UserError(f"the network takes the groups {taken}, but the observations are {given}.")
    for group, end in zip(groups, inputs, strict=True):
        if group.history < 1 or not group.terms:
            raise UserError(f"group '{group.name}': it must have terms, and a history of at least 1.")
        for term in group.terms:
            _check_term(term, len(contract.joints))
            if term.quantity.startswith(GAIT_PHASE) and contract.gait_clock is None:
                raise UserError(f"term '{term.name}' is {term.quantity}, but the contract has no gait_clock.")
        if group.shape != end.shape:
            raise UserError(
                f"the terms of group '{group.name}' have shape {list(group.shape)} together, but input '{end.name}' "
                f"of the network has {list(end.shape)}."
            )


def _check_term(term: Term, joints: int) -> None:
    if term.quantity == CUSTOM:
        return
    if term.quantity not in QUANTITIES:
        raise unknown("quantity", term.quantity, (*QUANTITIES, CUSTOM))
    size = len(QUANTITIES[term.quantity].components) or joints
    if len(term.components) != size or list(term.shape) != [size]:
        raise UserError(
            f"term '{term.name}' has {len(term.components)} components and shape {list(term.shape)}; "
            f"{term.quantity} has {size} components."
        )


def _check_unique(what: str, names: Iterable[str]) -> None:
    listed = list(names)
    if len(set(listed)) < len(listed):
        raise UserError(f"{what} have the same name.")


def _pretty(value: Any, indent: str) -> str:
    line = json.dumps(value, allow_nan=False)
    if len(indent) + len(line) <= 110 or not isinstance(value, dict | list | tuple) or not value:
        return line
    inner = indent + "  "
    if isinstance(value, dict):
        parts = [f"{json.dumps(key)}: {_pretty(item, inner)}" for key, item in value.items()]
    else:
        parts = [_pretty(item, inner) for item in value]
    opening, closing = "{}" if isinstance(value, dict) else "[]"
    return f"{opening}\n{inner}" + f",\n{inner}".join(parts) + f"\n{indent}{closing}"
