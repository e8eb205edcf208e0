"""The contract of an exported policy: all that someone needs to run its network on the robot it was trained for.

It is written as `policy.json` with every number at full precision. `humoslope play` reads nothing else but the network
and the robot model that the contract names.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from humoslope.deploy.quantities import QUANTITIES
from humoslope.deploy.typed_json import typed
from humoslope.errors import UserError, unknown

FILE = "policy.json"
VERSION = 1
"""Raised when what an older reader takes from the file changes its meaning."""

Range = tuple[float, float]


@dataclass(frozen=True)
class Training:
    """Where the policy comes from; nothing here is needed to run it.

    Attributes:
        checkpoint: Name of the file.
        sha256: Of that file, hexadecimal.
        iteration: Training iterations before it.
        environment_steps: Control steps seen, of all worlds together.
        harness: Scale in [0, 1] of the training harness at the end; null if there was none.
        started_from: What the training went on from; null if from nothing.
    """

    task: str
    checkpoint: str
    sha256: str
    iteration: int
    environment_steps: int
    harness: float | None
    started_from: Training | None


@dataclass(frozen=True)
class Network:
    """The policy as ONNX, float32, one row in and one row out, its normaliser inside.

    Attributes:
        file: Path relative to the contract.
        sha256: Of that file, hexadecimal.
        input, inputs: Name and length of the observation, shape [1, inputs].
        output, outputs: Name and length of the action, shape [1, outputs].
    """

    file: str
    sha256: str
    input: str
    inputs: int
    output: str
    outputs: int


@dataclass(frozen=True)
class RobotModel:
    """The robot as MJCF without ground, actuators and sensors; its `<option>` is the physics of the evaluation.

    Attributes:
        name: Of the robot.
        file: Path relative to the contract.
        root_body: The body with the free joint, whose frame the observations use.
        foot_geoms: What touches the ground under the feet; its friction is the contact's.
        default_root_height_m: Height of the root above the soles' ground in the default pose.
    """

    name: str
    file: str
    root_body: str
    foot_geoms: tuple[str, ...]
    default_root_height_m: float


@dataclass(frozen=True)
class Timing:
    """Control and physics.

    Attributes:
        control_step_s: The network runs once in this time and its targets are held.
        physics_step_s: Of the evaluation.
        observation_age_s: What is observed is this much older than the moment its action takes effect.
    """

    control_step_s: float
    physics_step_s: float
    observation_age_s: float


@dataclass(frozen=True)
class Action:
    """What the network's output means. Neither output nor target is clipped."""

    target: Literal["default_rad + action_scale_rad * output"]
    torque: Literal["stiffness_nm_rad * (target - position) - damping_nms_rad * velocity, within +-effort_limit_nm"]


@dataclass(frozen=True)
class Joint:
    """A joint, at its place in the order of actions and observations.

    Attributes:
        default_rad: Where a zero action holds it.
        action_scale_rad: How far one unit of action moves its target.
        stiffness_nm_rad, damping_nms_rad: Gains of the position control.
        effort_limit_nm: Largest torque.
        armature_kg_m2: Rotor inertia seen at the joint.
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
    """A part of the observation: `scale` times a quantity.

    Attributes:
        name: In the task.
        quantity: One of `humoslope.deploy.quantities`.
        meaning, frame, unit: Of the quantity, in words; one unit for all components, or one for each.
        components: What its numbers are, in order.
        scale: Factor on every component.
        training_noise: Half-width of the uniform noise in training, before the scale.
    """

    name: str
    quantity: str
    meaning: str
    frame: str
    unit: tuple[str, ...]
    components: tuple[str, ...]
    scale: float
    training_noise: float


@dataclass(frozen=True)
class Observation:
    """How the network's input is put together.

    Attributes:
        history: Control steps that it spans.
        layout: Term by term, and within a term frame by frame.
        start: What fills the history before there is one.
    """

    history: int
    layout: Literal["terms in this order; of each term all frames, oldest first"]
    start: Literal["all frames equal the first one"]
    terms: tuple[Term, ...]


@dataclass(frozen=True)
class Steering:
    """How yaw rates were commanded where a straight course was to be kept; `wrap` brings an angle into +-pi."""

    law: Literal["clamp(heading_gain_per_s * wrap(-lateral_gain_rad_m * place_left_of_course - yaw), +-limit_rad_s)"]
    heading_gain_per_s: float
    lateral_gain_rad_m: float
    limit_rad_s: float


@dataclass(frozen=True)
class Commands:
    """What the policy was trained to be asked.

    Attributes:
        forward_m_s, left_m_s: Speed along the ground.
        yaw_rate_rad_s: Turning left is positive.
        stands: Whether standing still (all zero) was among it, besides the ranges.
        held_s: Shortest and longest time between changes.
        steering: What some yaw rates came from; a person's joystick may take its place.
    """

    forward_m_s: Range
    left_m_s: Range
    yaw_rate_rad_s: Range
    stands: bool
    held_s: Range
    steering: Steering


@dataclass(frozen=True)
class Fall:
    """What counted as a fall in training and evaluation; null where it did not matter.

    Attributes:
        root_height_below_m: Root above the ground below it.
        tilt_above_deg: Root's z axis off the vertical.
    """

    root_height_below_m: float | None
    tilt_above_deg: float | None


@dataclass(frozen=True)
class Contract:
    """See the module.

    Attributes:
        exported_by: Version and commit of the code that wrote it.
        conventions: What holds for all of it.
    """

    format: Literal["humoslope-policy"]
    version: int
    exported_by: str
    conventions: str
    training: Training
    network: Network
    robot: RobotModel
    timing: Timing
    action: Action
    joints: tuple[Joint, ...]
    observation: Observation
    commands: Commands
    fall: Fall

    @property
    def decimation(self) -> int:
        """Physics steps in a control step."""
        return round(self.timing.control_step_s / self.timing.physics_step_s)

    def to_json(self) -> str:
        """The contract as text, one line for what fits on it."""
        return _pretty(asdict(self), "") + "\n"


def read(folder: Path) -> Contract:
    """The contract in an export folder.

    Raises:
        UserError: If there is none, or it is broken, foreign, of another version or contradicts itself.
    """
    path = folder / FILE
    if not folder.is_dir():
        raise UserError(f"export folder '{folder}' does not exist; `humoslope export CHECKPOINT` writes one.")
    if not path.is_file():
        raise UserError(f"'{folder}' holds no {FILE}; `humoslope export CHECKPOINT` writes one.")
    try:
        raw = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, OSError) as error:
        raise UserError(f"contract '{path}' cannot be read: {error}.") from None
    if not isinstance(raw, dict) or raw.get("format") != "humoslope-policy":
        raise UserError(f"'{path}' is not the contract of a HumoSlope policy.")
    if raw.get("version") != VERSION:
        raise UserError(f"contract '{path}' has version {raw.get('version')}; this program reads version {VERSION}.")
    try:
        contract = typed(Contract, raw)
        _check(contract)
    except UserError as error:
        raise UserError(f"contract '{path}': {error}") from None
    return contract


def _check(contract: Contract) -> None:
    """Raises UserError where parts do not fit together."""
    joints, observation, timing = contract.joints, contract.observation, contract.timing
    if min(timing.control_step_s, timing.physics_step_s) <= 0.0 or contract.decimation < 1:
        raise UserError("timing: a step must be positive, and the physics step no longer than the control step.")
    if abs(contract.decimation * timing.physics_step_s - timing.control_step_s) > 1e-9:
        raise UserError("timing: the control step must be a whole number of physics steps.")
    if abs(timing.observation_age_s - timing.physics_step_s) > 1e-9:
        raise UserError("timing: this program observes one physics step before it acts; observation_age_s is another.")
    if contract.network.outputs != len(joints):
        raise UserError(f"the network has {contract.network.outputs} outputs for {len(joints)} joints.")
    if len({joint.name for joint in joints}) < len(joints):
        raise UserError("joints: two have the same name.")
    for term in observation.terms:
        if term.quantity not in QUANTITIES:
            raise unknown("quantity", term.quantity, QUANTITIES)
        size = len(QUANTITIES[term.quantity].components) or len(joints)
        if len(term.components) != size:
            raise UserError(f"term '{term.name}' has {len(term.components)} components; {term.quantity} has {size}.")
    inputs = observation.history * sum(len(term.components) for term in observation.terms)
    if inputs != contract.network.inputs:
        raise UserError(f"its terms make {inputs} numbers, but the network has {contract.network.inputs} inputs.")


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
