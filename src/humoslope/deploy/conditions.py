"""Physical conditions other than those that an export was made for: robot, sensors, timing and pushes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from humoslope.ranges import Checked, NotNegative, Positive, Range, Timestep

Angle = Annotated[float, Range(-math.pi, math.pi)]
"""An angle, rad."""


@dataclass(frozen=True)
class Conditions(Checked):
    """Disturbances of a robot in plain MuJoCo. The defaults change nothing.

    Attributes:
        friction: Coefficient of friction between feet and ground; by default the course's own.
        load_kg: Mass added to `load_body` at its centre of mass, as a point.
        load_body: Body that carries the load.
        delay_s: Time between a new joint target and its effect, in addition to the age of the observation; rounded to
            whole physics steps.
        strength: Factor on the torque of every motor, its limit included.
        encoder_bias_rad: Offset of the measured from the true position of each joint, in the order of the contract;
            empty for none. The position control of a motor uses the same encoder.
        imu_tilt_rad: Rotation vector about the root's x and y axes that turns the IMU as the policy believes it to be
            mounted into the IMU as it is.
        push_m_s: Horizontal speed, in a random direction, that a push adds to the whole robot.
        push_every_s: Time between pushes; the first one comes after this time.
        timestep_s: Physics step, s; by default the contract's. The age of the observation stays the contract's.

    Raises:
        UserError: If a value is impossible.
    """

    VERB: ClassVar[str] = "conditions"

    friction: NotNegative | None = None
    load_kg: NotNegative = 0.0
    load_body: str = "torso_link"
    delay_s: Annotated[float, Range(0.0, 10.0)] = 0.0
    strength: Positive = 1.0
    encoder_bias_rad: tuple[Angle, ...] = ()
    imu_tilt_rad: tuple[Angle, Angle] = (0.0, 0.0)
    push_m_s: Annotated[float, Range(0.0, 100.0)] = 0.0
    push_every_s: Positive = 5.0
    timestep_s: Timestep | None = None


NOMINAL = Conditions()
"""Conditions that an export was made for."""
