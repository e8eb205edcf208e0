"""A robot in any state on a plane of any slope, without physics."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch

from humoslope.scene.height_scan import HeightScan, HeightScanCfg
from humoslope.scene.scene import build_model
from humoslope.scene.signals import Signals
from humoslope.scene.tiles import Tiles
from humoslope.terrain import TerrainGridCfg, TerrainQueries
from humoslope.terrain.grid import Terrain
from robots.unitree_g1 import UNITREE_G1


class Posed:
    """Signals and ground patch of one world that reads what `put` wrote."""

    def __init__(self, model: mujoco.MjModel, slope: float, uphill: float) -> None:
        self._model = model
        self._readings = {
            "sensordata": torch.zeros(1, model.nsensordata),
            "actuator_force": torch.zeros(1, model.nu),
        }
        self.put(root_quat_w=[1.0, 0.0, 0.0, 0.0], torso_quat_w=[1.0, 0.0, 0.0, 0.0])
        sim = SimpleNamespace(model=model, read=self._readings.__getitem__)
        terrain = plane(slope, uphill)
        queries, tiles = TerrainQueries(terrain, "cpu"), Tiles(terrain, 1, torch.device("cpu"))
        self.signals = Signals(sim, UNITREE_G1, queries)
        self.height_scan = HeightScan(HeightScanCfg(), self.signals, queries, tiles)

    def put(self, **values: object) -> None:
        """Writes readings by sensor name ("left" and "right" of a pair: `foot_force_w={"left": ...}`)."""
        for name, value in values.items():
            sides = value if isinstance(value, dict) else {"": value}
            for side, vector in sides.items():
                sensor = self._model.sensor(f"{name}/{side}" if side else name)
                columns = slice(sensor.adr[0], sensor.adr[0] + sensor.dim[0])
                self._readings["sensordata"][0, columns] = torch.as_tensor(np.array(vector), dtype=torch.float32)

    def stand(self, **joints: float) -> None:
        """Puts the G1 on the slope, the default pose but for these joints (rad), the lower sole on the ground."""
        data = mujoco.MjData(self._model)
        data.qpos[3:] = [1.0, 0.0, 0.0, 0.0, *UNITREE_G1.default_joint_pos]
        for name, angle in joints.items():
            data.joint(name).qpos = angle
        for _ in range(2):  # the second time at the height that the first one found
            data.qpos[2] -= self.signals.foot_height.min().item()
            mujoco.mj_forward(self._model, data)
            self._readings["sensordata"][0] = torch.as_tensor(data.sensordata, dtype=torch.float32)
            self.signals.refresh()

    def put_joints(self, vel: torch.Tensor, torque: torch.Tensor, pos: torch.Tensor | None = None) -> None:
        """Writes the readings of all joints [J], rad/s, Nm and rad; without `pos` they stay where they are."""
        self._readings["actuator_force"][0] = torque
        for kind, values in (("joint_vel", vel), ("joint_pos", pos)):
            if values is not None:
                first = self._model.sensor(f"{kind}/{UNITREE_G1.joint_names[0]}").adr[0]
                self._readings["sensordata"][0, first : first + len(values)] = values


def plane(slope: float, uphill: float = 0.0) -> Terrain:
    """Ground that rises by `slope` degrees towards `uphill` degrees, and is at height 0 in its middle."""
    axis = np.arange(-30, 31) * 0.1
    x, y = np.meshgrid(axis, axis, indexing="ij")
    along = x * math.cos(math.radians(uphill)) + y * math.sin(math.radians(uphill))
    return Terrain(
        heights=(math.tan(math.radians(slope)) * along).astype(np.float32),
        cell=0.1,
        origin=(-3.0, -3.0),
        tile_origin=np.array([[[-3.0, 0.0, 0.0]]]),
        kind=("plane",),
        grade=np.full((1, 1), abs(slope)),
        tile_length=6.0,
        tile_width=6.0,
    )


@pytest.fixture(scope="session")
def g1() -> mujoco.MjModel:
    return build_model(
        UNITREE_G1, TerrainGridCfg(columns={"flat": 1.0}, levels=1, num_columns=1).build(), 0.005, "elliptic"
    )


@pytest.fixture(scope="session")
def pose(g1: mujoco.MjModel) -> Callable[..., Posed]:
    """pose(30.0, uphill=90.0, root_lin_vel_w=[...]): a robot at the middle of a slope, with these readings."""

    def make(slope: float = 0.0, uphill: float = 0.0, **values: object) -> Posed:
        posed = Posed(g1, slope, uphill)
        posed.put(**values)
        posed.signals.refresh()
        return posed

    return make
