"""What an observation can be made of: quantities that a robot measures or is told, described so that anyone can."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """What is known at one instant. Joints are in the order of the contract.

    Attributes:
        root_quat_w: [4] attitude of the root, w first.
        root_ang_vel_b: [3] rad/s.
        joint_pos_rel: [J] from the default pose, rad.
        joint_vel: [J] rad/s.
        command: [3] forward and left, m/s; yaw rate, rad/s.
        last_action: [J] what the network gave last; zero before the first time.
    """

    root_quat_w: Array
    root_ang_vel_b: Array
    joint_pos_rel: Array
    joint_vel: Array
    command: Array
    last_action: Array

    @property
    def up_b(self) -> Array:
        """[3] the world's up direction in the root frame: the last row of the rotation matrix of `root_quat_w`."""
        w, x, y, z = self.root_quat_w
        return np.array([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)])


@dataclass(frozen=True)
class Quantity:
    """A quantity in words and as a function.

    Attributes:
        meaning: A sentence for who builds the observation elsewhere.
        frame: The frame of its components; empty if it has none.
        unit: Of each component.
        components: Their names in order; empty if there is one for each joint.
        read: Its components.
    """

    meaning: str
    frame: str
    unit: tuple[str, ...]
    components: tuple[str, ...]
    read: Callable[[Measured], Array]


XYZ = ("x", "y", "z")
ROOT = "root body: x forward, y left, z up"

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
