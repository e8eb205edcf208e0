"""A block on the track stays or slides as Coulomb's law says, at every grade and friction tier, banked or not."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
import torch

from humoslope.evaluation.track.protocol import HeldOutProtocol
from humoslope.terrain import TerrainQueries, add_terrain, course
from tests.terrain.ground import normal as normal_at

PROTOCOL = HeldOutProtocol()
GRADES, TIERS = PROTOCOL.grades, PROTOCOL.tiers
PLACES = {"smooth": 4.0, "banked": 14.85}  # on the first slope up, and where the third one leans to a side
SECONDS = 0.3
RADIUS, HALF = 0.02, 0.06
SHARE = 0.5
"""Of the friction that would hold it has a block that must slide."""


class Blocks:
    """Blocks on four spherical feet, at rest on the track, each with its own friction."""

    def __init__(self) -> None:
        self.ground = course.find("held-out-track").ground(GRADES).build()
        self.queries = TerrainQueries(self.ground, "cpu")
        self.spec = mujoco.MjSpec()
        self.spec.option.timestep = PROTOCOL.timestep
        self.spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        add_terrain(self.spec, self.ground)
        self.count = 0

    def add(self, grade: float, place: float, mu: float) -> int:
        """Puts a block on the centre line at `place`; returns its number."""
        origin = self.ground.tile_origin[0, GRADES.index(grade)]
        xy = torch.tensor([origin[0] + place, origin[1]], dtype=torch.float32)
        normal = self.normal(grade, place)
        pos = np.array([*xy.tolist(), float(self.queries.height(xy))]) + (RADIUS + 1e-5) * normal
        quat = np.zeros(4)
        mujoco.mju_quatZ2Vec(quat, normal)
        body = self.spec.worldbody.add_body(pos=pos, quat=quat)
        body.add_freejoint()
        for x in (-HALF, HALF):
            for y in (-HALF, HALF):
                body.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_SPHERE,
                    size=[RADIUS, 0.0, 0.0],
                    pos=[x, y, 0.0],
                    mass=1.0,
                    friction=[mu, 0.005, 0.0001],
                    condim=3,
                    priority=1,
                    contype=0,
                    conaffinity=1,
                )
        self.count += 1
        return self.count - 1

    def normal(self, grade: float, place: float) -> np.ndarray:
        origin = self.ground.tile_origin[0, GRADES.index(grade)]
        xy = torch.tensor([origin[0] + place, origin[1]], dtype=torch.float32)
        return normal_at(self.queries, xy, 0.02).double().numpy()

    def slide(self) -> tuple[np.ndarray, np.ndarray]:
        """How far each block has moved after `SECONDS`, m, and its mean acceleration, m/s^2."""
        model = self.spec.compile()
        data = mujoco.MjData(model)
        before = data.qpos.reshape(-1, 7)[:, :3].copy()
        mujoco.mj_step(model, data, round(SECONDS / PROTOCOL.timestep))
        return data.qpos.reshape(-1, 7)[:, :3] - before, data.qvel.reshape(-1, 6)[:, :3] / SECONDS


def steepness(normal: np.ndarray) -> float:
    """Tangent of the angle between a plane and the horizontal."""
    return math.hypot(normal[0], normal[1]) / normal[2]


@pytest.mark.parametrize("where", PLACES)
def test_a_block_stays_at_every_tier_and_slides_below_the_steepness_of_its_ground(where: str) -> None:
    place, blocks = PLACES[where], Blocks()
    stay, slide = {}, {}
    for grade in GRADES:
        tangent = math.tan(math.radians(grade))
        for tier in TIERS:
            stay[grade, tier] = blocks.add(grade, place, tangent + tier)
        total = steepness(blocks.normal(grade, place))
        bank = math.tan(math.radians(8.0)) if where == "banked" else 0.0
        assert total == pytest.approx(math.hypot(tangent, bank), rel=1e-3, abs=1e-3)
        stay[grade, "just enough"] = blocks.add(grade, place, total + 0.03)
        if total > 0.01:
            slide[grade] = (blocks.add(grade, place, SHARE * total), math.atan(total))
    moved, acceleration = blocks.slide()
    for number in stay.values():
        assert np.linalg.norm(moved[number]) < 0.002
    assert len(slide) >= 3
    for grade, (number, angle) in slide.items():
        # g (sin - mu cos), down the steepest line; the feet chatter a little.
        expected = 9.81 * (1.0 - SHARE) * math.sin(angle)
        normal = blocks.normal(grade, place)
        down = np.array([normal[0] * normal[2], normal[1] * normal[2], normal[2] ** 2 - 1.0])
        assert acceleration[number] @ (down / np.linalg.norm(down)) == pytest.approx(expected, rel=0.1)
