"""Physical conditions other than those that an export was made for: robot, sensors, timing and pushes."""

from __future__ import annotations

from dataclasses import dataclass

from humoslope.errors import require_not_negative, require_positive


@dataclass(frozen=True)
class Conditions:
    """Disturbances of a robot in plain MuJoCo. The defaults change nothing.

    Attributes:
        friction: Coefficient of friction between feet and ground; null for the course's own.
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
        timestep_s: Physics step; null for the contract's. The age of the observation stays the contract's.

    Raises:
        UserError: If a value is impossible.
    """

    friction: float | None = None
    load_kg: float = 0.0
    load_body: str = "torso_link"
    delay_s: float = 0.0
    strength: float = 1.0
    encoder_bias_rad: tuple[float, ...] = ()
    imu_tilt_rad: tuple[float, float] = (0.0, 0.0)
    push_m_s: float = 0.0
    push_every_s: float = 5.0
    timestep_s: float | None = None

    def __post_init__(self) -> None:
        require_not_negative("conditions", load_kg=self.load_kg, delay_s=self.delay_s, push_m_s=self.push_m_s)
        require_positive("conditions", strength=self.strength, push_every_s=self.push_every_s)
        if self.friction is not None:
            require_not_negative("conditions", friction=self.friction)
        if self.timestep_s is not None:
            require_positive("conditions", timestep_s=self.timestep_s)


NOMINAL = Conditions()
"""Conditions that an export was made for."""
