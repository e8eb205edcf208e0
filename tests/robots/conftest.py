from __future__ import annotations

import mujoco
import pytest

from humoslope.scene.sensors import add_contact_sensors, add_robot_sensors
from humoslope.terrain.mjcf import TERRAIN_GEOM
from robots.unitree_g1 import UNITREE_G1


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return UNITREE_G1.make_spec().compile()


@pytest.fixture(scope="module")
def model_on_ground() -> mujoco.MjModel:
    spec = UNITREE_G1.make_spec()
    add_robot_sensors(spec, UNITREE_G1)
    spec.worldbody.add_geom(name=TERRAIN_GEOM, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    add_contact_sensors(spec, UNITREE_G1)
    return spec.compile()
