"""Models the simulation tests share. Each compiled warp variant costs up to a minute once, so there are few."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from humoslope.scene.sensors import add_contact_sensors, add_robot_sensors
from humoslope.terrain.mjcf import TERRAIN_GEOM
from robots.unitree_g1 import UNITREE_G1

ROWS, COLS, CELL = 81, 161, 0.1  # y, x; m
RAMP = np.radians(15.0)

RIG = """
<mujoco>
  <option timestep="0.005" cone="elliptic" integrator="implicitfast"/>
  <worldbody>
    <geom name="terrain" type="plane" size="0 0 1"/>
    <body name="box" pos="0 0 0.1">
      <freejoint/>
      <geom name="box" type="box" size="0.1 0.1 0.1" mass="2" friction="0.5 0.005 0.0001" priority="1"/>
    </body>
    <body name="flyer" pos="3 0 5" gravcomp="1">
      <freejoint/>
      <geom name="flyer" size="0.1" mass="4" contype="0" conaffinity="0"/>
    </body>
    <body name="arm" pos="0 3 2">
      <joint name="arm" axis="0 1 0"/>
      <geom name="arm" type="capsule" size="0.02" fromto="0 0 0 0.4 0 0" mass="1"/>
    </body>
  </worldbody>
  <actuator><position name="arm" joint="arm" kp="30" kv="2"/></actuator>
  <sensor>
    <framepos objtype="xbody" objname="box"/>
    <jointpos joint="arm"/>
    <contact geom1="terrain" body2="box" data="force" reduce="netforce"/>
  </sensor>
</mujoco>
"""
"""A box on the ground, a body that floats free, and an arm held by a position actuator."""


@pytest.fixture(scope="session")
def rig() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(RIG)


@pytest.fixture(scope="session")
def g1_on_plane() -> mujoco.MjModel:
    spec = UNITREE_G1.make_spec()
    add_robot_sensors(spec, UNITREE_G1)
    spec.worldbody.add_geom(name=TERRAIN_GEOM, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    add_contact_sensors(spec, UNITREE_G1)
    return spec.compile()


def ground_height(x: float | np.ndarray, y: float | np.ndarray) -> np.ndarray:
    """Level for x < -2, a ramp of 15 degrees for x > 2 at y < 0, bumps of 3 cm for x > 2 at y > 1; all in m."""
    x, y = np.broadcast_arrays(x, y)
    ramp = np.where((x > 2) & (y < 0), (x - 2) * np.tan(RAMP), 0.0)
    bumps = np.where((x > 2) & (y > 1), 0.03 * np.sin(7.0 * x) * np.cos(9.0 * y), 0.0)
    return ramp + bumps


@pytest.fixture(scope="session", name="ground_height")
def ground_height_fixture() -> Callable[..., np.ndarray]:
    return ground_height


@pytest.fixture(scope="session")
def g1_on_height_field() -> mujoco.MjModel:
    spec = UNITREE_G1.make_spec()
    add_robot_sensors(spec, UNITREE_G1)
    x = (np.arange(COLS) - COLS // 2) * CELL
    y = (np.arange(ROWS) - ROWS // 2) * CELL
    height = ground_height(x[None, :], y[:, None])
    low, high = height.min(), height.max()
    spec.add_hfield(
        name=TERRAIN_GEOM,
        nrow=ROWS,
        ncol=COLS,
        size=[x[-1], y[-1], high - low, 1.0],
        userdata=((height - low) / (high - low)).ravel(),
    )
    spec.worldbody.add_geom(
        name=TERRAIN_GEOM, type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname=TERRAIN_GEOM, pos=[0, 0, low]
    )
    add_contact_sensors(spec, UNITREE_G1)
    return spec.compile()


@pytest.fixture(params=["native", "warp"])
def backend(request: pytest.FixtureRequest) -> str:
    """Both, on the CPU."""
    return request.param
