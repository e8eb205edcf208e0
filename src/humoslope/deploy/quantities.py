"""Quantities that an observation can consist of: what a robot measures or is commanded, in words and as functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from humoslope.deploy import rotation
from humoslope.errors import UserError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """Measurements, command and last action of one instant. Joints are in the order of the contract.

    Attributes:
        root_quat_w: [4] orientation of the root, w first.
        root_ang_vel_b: [3] angular velocity of the root in its own frame, rad/s.
        joint_pos_rel: [J] joint positions relative to the default pose, rad.
        joint_vel: [J] joint velocities, rad/s.
        command: [3] forward and lateral speed, m/s, and yaw rate, rad/s.
        last_action: [J] last output of the network; zero before the first one.
        root_lin_vel_b: [3] velocity of the root in its own frame, m/s; None if nothing tells it, as on a robot.
        gait_phase: [2] phases of the left and the right foot, rad; for contracts with a gait clock.
    """

    root_quat_w: Array
    root_ang_vel_b: Array
    joint_pos_rel: Array
    joint_vel: Array
    command: Array
    last_action: Array
    root_lin_vel_b: Array | None = None
    gait_phase: Array = field(default_factory=lambda: np.zeros(2))

    @property
    def up_b(self) -> Array:
        """The world's up direction in the root frame, [3]."""
        return rotation.up_b(self.root_quat_w)


@dataclass(frozen=True)
class Quantity:
    """A quantity in words and as a function.

    Attributes:
        meaning: Description for readers who compute the observation with their own code.
        frame: Reference frame of the components; empty if there is none.
        unit: Unit of each component.
        components: Names of the components in order; empty if there is one for each joint.
        read: Function that returns the components.
        measured: True if a robot's encoders and IMU, the command and a clock are enough to tell it.
    """

    meaning: str
    frame: str
    unit: tuple[str, ...]
    components: tuple[str, ...]
    read: Callable[[Measured], Array]
    measured: bool = True


CUSTOM = "custom"
"""Quantity of an observation that is none of `QUANTITIES`; only the code that it was trained with can compute it."""
XYZ = ("x", "y", "z")
FEET = ("left_foot", "right_foot")
GAIT_PHASE = "gait_phase_"
"""Beginning of the quantities that a gait clock gives; the rest is the function of the phase."""
ROOT = "root body: x forward, y left, z up"


def _velocity(measured: Measured) -> Array:
    if measured.root_lin_vel_b is None:
        raise UserError("root_linear_velocity is not measured here.")
    return measured.root_lin_vel_b


QUANTITIES = {
    "root_angular_velocity": Quantity(
        "Angular velocity of the root body, as its gyroscope measures it.",
        ROOT,
        ("rad/s",) * 3,
        XYZ,
        lambda measured: measured.root_ang_vel_b,
    ),
    "gravity_direction": Quantity(
        "Unit vector along gravity; (0, 0, -1) when the root stands upright.",
        ROOT,
        ("1",) * 3,
        XYZ,
        lambda measured: -measured.up_b,
    ),
    "velocity_command": Quantity(
        "Commanded speed of the root along the ground, and yaw rate; all zero asks it to stand.",
        "heading: forward along the ground in the direction of the root's yaw, left, up",
        ("m/s", "m/s", "rad/s"),
        ("forward", "left", "yaw_rate"),
        lambda measured: measured.command,
    ),
    "linear_velocity_command": Quantity(
        "Commanded speed of the root along the ground.",
        "heading: forward along the ground in the direction of the root's yaw, left",
        ("m/s",) * 2,
        ("forward", "left"),
        lambda measured: measured.command[:2],
    ),
    "yaw_rate_command": Quantity(
        "Commanded yaw rate.", "heading: up", ("rad/s",), ("yaw_rate",), lambda measured: measured.command[2:]
    ),
    "gait_phase_sine": Quantity(
        "Sine of each foot's phase by the contract's gait clock.",
        "",
        ("1",) * 2,
        FEET,
        lambda measured: np.sin(measured.gait_phase),
    ),
    "gait_phase_cosine": Quantity(
        "Cosine of each foot's phase by the contract's gait clock.",
        "",
        ("1",) * 2,
        FEET,
        lambda measured: np.cos(measured.gait_phase),
    ),
    "root_linear_velocity": Quantity(
        "Velocity of the root body's origin; known in simulation, and not measured by the robot.",
        ROOT,
        ("m/s",) * 3,
        XYZ,
        _velocity,
        measured=False,
    ),
    "joint_position_offset": Quantity(
        "Position of each joint less its default_rad.", "", ("rad",), (), lambda measured: measured.joint_pos_rel
    ),
    "joint_velocity": Quantity("Velocity of each joint.", "", ("rad/s",), (), lambda measured: measured.joint_vel),
    "last_action": Quantity(
        "The network's last output as it was given, before scale and default; zero before the first one.",
        "",
        ("1",),
        (),
        lambda measured: measured.last_action,
    ),
}
