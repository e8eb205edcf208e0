"""Robot and terrain in one compiled model."""

from __future__ import annotations

from typing import Literal

import mujoco

from humoslope.errors import unknown
from humoslope.scene.robot import Robot
from humoslope.scene.sensors import add_contact_sensors, add_robot_sensors
from humoslope.terrain.grid import Terrain
from humoslope.terrain.mjcf import add_terrain

CONES = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}


def build_model(
    robot: Robot, terrain: Terrain, timestep: float, cone: Literal["elliptic", "pyramidal"]
) -> mujoco.MjModel:
    """Compiles the robot on the terrain, with contact sensors between them.

    Args:
        timestep: Physics step, s.
        cone: Shape of the friction cone.

    Raises:
        UserError: If the cone is unknown.
    """
    if cone not in CONES:
        raise unknown("friction cone", cone, CONES)
    spec = robot.make_spec()
    add_robot_sensors(spec, robot)
    add_terrain(spec, terrain)
    add_contact_sensors(spec, robot)
    spec.option.timestep = timestep
    spec.option.cone = CONES[cone]
    return spec.compile()
