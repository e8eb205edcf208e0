"""Robot and terrain in one compiled model."""

from __future__ import annotations

from typing import Literal

import mujoco

from humoslope.errors import require_not_negative, unknown
from humoslope.scene.fit import check_fit
from humoslope.scene.robot import Robot
from humoslope.scene.sensors import add_contact_sensors, add_robot_sensors
from humoslope.terrain.grid import Terrain
from humoslope.terrain.mjcf import add_terrain

CONES = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}


def build_model(
    robot: Robot,
    terrain: Terrain,
    timestep: float,
    cone: Literal["elliptic", "pyramidal"],
    max_control_delay_s: float = 0.0,
) -> mujoco.MjModel:
    """Compiles the robot on the terrain, with contact sensors between them.

    Args:
        timestep: Physics step, s.
        cone: Shape of the friction cone.
        max_control_delay_s: Longest delay of a control that a simulation may set, s. The model itself has no delay,
            only the buffers for one, if any.

    Raises:
        UserError: If the cone is unknown, the delay is negative or not finite, or the robot does not fit its own model
            (see `check_fit`).
    """
    if cone not in CONES:
        raise unknown("friction cone", cone, CONES)
    spec = robot.make_spec()
    check_fit(robot, spec)
    add_robot_sensors(spec, robot)
    add_terrain(spec, terrain)
    add_contact_sensors(spec, robot)
    spec.option.timestep = timestep
    spec.option.cone = CONES[cone]
    require_not_negative("sim", max_control_delay_s=max_control_delay_s)
    for actuator in spec.actuators:
        actuator.nsample = round(max_control_delay_s / timestep)
    return spec.compile()
