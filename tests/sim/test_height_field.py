"""Contacts with a height field are those of C MuJoCo anywhere on it, and the correction fits one version only."""

from __future__ import annotations

import importlib
import inspect

import mujoco
import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from humoslope.errors import UserError
from humoslope.sim import height_field, make_simulation

CELL, SIZE = 0.1, 1081  # m, vertices along each side: as large as the terrain of Stage I
HALF = 0.5 * CELL * (SIZE - 1)
PERIOD = 100  # vertices after which the ground repeats itself, so that every distance sees the same ground
RADIUS = 0.015  # m, a sphere of the robot's foot
DISTANCES = (0.0, 10.0, 20.0, 40.0)  # m along x and along y, so that the last is 60 m from the centre
PLACES = 32  # at each distance

Array = NDArray[np.float64]


def flat() -> Array:
    return np.zeros((PERIOD, PERIOD))


def ramp() -> Array:
    return np.tile(np.tan(np.radians(30.0)) * CELL * np.arange(PERIOD), (PERIOD, 1))


def rough() -> Array:
    return np.random.default_rng(0).uniform(-0.02, 0.02, (PERIOD, PERIOD))


def ball_on(ground: Array) -> tuple[mujoco.MjModel, Array]:
    """A ball above the ground repeated over the field, and the heights [rows along y, columns along x]."""
    repeats = -(-SIZE // PERIOD)
    heights = np.tile(ground, (repeats, repeats))[:SIZE, :SIZE]
    low, span = heights.min(), np.ptp(heights) or 0.01
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.005
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.add_hfield(
        name="ground",
        size=[HALF, HALF, span, 1.0],
        nrow=SIZE,
        ncol=SIZE,
        userdata=((heights - low) / span).ravel().astype(np.float32),
    )
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="ground", pos=[0, 0, low])
    ball = spec.worldbody.add_body()
    ball.add_freejoint()
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0, 0], mass=1)
    return spec.compile(), heights


def balls(heights: Array, depth: float, across: float) -> torch.Tensor:
    """Poses [distances * places, 7] of balls whose lowest point along the ground's normal is `depth` below it.

    Args:
        across: Cosine of the grade.
    """
    rng = np.random.default_rng(1)
    local = 1.0 + rng.uniform(0.0, 2.0, (2, PLACES))  # m, the same at all distances
    qpos = np.zeros((len(DISTANCES), PLACES, 7))
    for row, distance in zip(qpos, DISTANCES, strict=True):
        row[:, :2] = (local * [[1.0], [-1.0]] + [[distance], [-distance]]).T
    # The ground starts at the field's corner; where a period of it begins next to the centre.
    qpos[..., :2] += (0.5 * PERIOD * CELL - HALF) % (PERIOD * CELL) - 0.5 * PERIOD * CELL
    qpos = qpos.astype(np.float32).reshape(-1, 7).astype(np.float64)
    column, line = (qpos[:, 0] + HALF) / CELL, (qpos[:, 1] + HALF) / CELL
    j, i = np.floor(column).astype(int), np.floor(line).astype(int)
    u, v = column - j, line - i
    a, b, c, d = heights[i, j], heights[i, j + 1], heights[i + 1, j], heights[i + 1, j + 1]
    on_triangle = np.where(u + v < 1.0, a + (b - a) * u + (c - a) * v, d + (c - d) * (1 - u) + (b - d) * (1 - v))
    qpos[:, 2] = on_triangle + (RADIUS - depth) / across
    qpos[:, 3] = 1.0
    return torch.tensor(qpos.astype(np.float32))


@pytest.mark.parametrize("ground", [flat, ramp, rough], ids=lambda ground: ground.__name__)
@pytest.mark.parametrize("depth", [0.001, 0.03])
def test_contacts_and_velocities_are_those_of_c_mujoco_at_any_distance(ground, depth: float) -> None:
    model, heights = ball_on(ground())
    qpos = balls(heights, depth, np.cos(np.radians(30.0)) if ground is ramp else 1.0)
    simulation = make_simulation(model, len(qpos), "warp", "cpu")
    simulation.reset(torch.ones(len(qpos), dtype=torch.bool), qpos, torch.zeros(len(qpos), model.nv))
    simulation.step(1)
    contacts = simulation._d.contact
    count = int(simulation._d.nacon.numpy()[0])
    world, dist = contacts.worldid.numpy()[:count], contacts.dist.numpy()[:count]
    normal = contacts.frame.numpy()[:count, 0]

    too_deep, turned, apart = np.zeros((3, len(qpos)))
    for k, pose in enumerate(qpos.numpy()):
        data = mujoco.MjData(model)
        data.qpos[:] = pose
        mujoco.mj_step(model, data)
        apart[k] = np.abs(simulation.state("qvel")[k].numpy() - data.qvel)[:3].max()
        mine = np.flatnonzero(world == k)
        if data.ncon == 0:
            continue
        assert len(mine) > 0
        deepest, theirs = mine[dist[mine].argmin()], min(data.contact, key=lambda contact: contact.dist)
        too_deep[k] = theirs.dist - dist[deepest]
        turned[k] = np.degrees(np.arccos(np.clip(theirs.frame[:3] @ normal[deepest], -1, 1)))
    off, turned, apart = (x.reshape(len(DISTANCES), PLACES) for x in (np.abs(too_deep), turned, apart))

    if depth < RADIUS and ground is not rough:
        assert off.max() < 1e-5  # m
        assert turned.max() < 0.1  # degrees
        assert apart.max() < 0.01  # m/s
    else:
        # A centre in the ground has several ways out of a cell that are nearly as short, and the backends take
        # different ones; on rough ground float32 takes some touches of a cell's side for overlaps. Without the
        # correction contacts are up to 7 m deeper and 90 m/s are reached.
        assert off.max() < 0.07  # m
        assert apart.max() < 1.2  # m/s
    if depth < RADIUS:
        for share in ((off > 1e-3).mean(axis=1), (turned > 5.0).mean(axis=1), (apart > 0.05).mean(axis=1)):
            assert share.max() <= 0.1
    assert simulation.warnings() == []
    assert not simulation.diverged().any()


def test_another_version_of_mujoco_warp_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    height_field.collide_near_geoms()
    monkeypatch.delattr(importlib.import_module(height_field._MODULE), height_field._CORRECTED)
    monkeypatch.setattr(height_field, "version", lambda name: "3.15.0")
    with pytest.raises(UserError, match=r"mujoco-warp 3\.15\.0 is installed.*install mujoco-warp==3\.14\.0"):
        height_field.collide_near_geoms()


@pytest.mark.parametrize("source", ["x = 1\n", "a = 1\na = 1\n"])
def test_a_source_that_the_correction_does_not_fit_is_refused(source: str) -> None:
    with pytest.raises(UserError, match="'a = 1' occurs [02] times instead of once"):
        height_field.corrected(source, {"a = 1\n": "a = 2\n"})


def test_no_kernel_of_the_original_is_taken_for_a_corrected_one() -> None:
    """MuJoCo-Warp keeps kernels by the name of their builder, Warp by their source."""
    height_field.collide_near_geoms()
    module = importlib.import_module(height_field._MODULE)
    builder = getattr(module, height_field._BUILDER)
    assert inspect.unwrap(builder).__name__ == height_field._CORRECTED
    height_field.collide_near_geoms()
    assert getattr(module, height_field._BUILDER) is builder, "it is installed once"
