from __future__ import annotations

import mujoco
import pytest

from humoslope.scene.sensors import TERRAIN_GEOM, add_contact_sensors
from robots.unitree_g1 import UNITREE_G1


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return UNITREE_G1.make_spec().compile()


@pytest.fixture(scope="module")
def model_on_ground() -> mujoco.MjModel:
    spec = UNITREE_G1.make_spec()
    spec.worldbody.add_geom(name=TERRAIN_GEOM, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    add_contact_sensors(spec, UNITREE_G1)
    return spec.compile()
