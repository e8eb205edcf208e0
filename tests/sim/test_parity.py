"""The two backends tell the same story of the same robot."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
import torch

from humoslope.scene.sensors import add_contact_sensors, add_robot_sensors
from humoslope.sim import Simulation, make_simulation
from humoslope.terrain.mjcf import TERRAIN_GEOM
from robots.unitree_g1 import UNITREE_G1_SOLID

CONTROL_STEPS, DECIMATION = 20, 4  # 0.4 s: a drop, the impact, and the legs swinging under load

# Float32 against float64. On a plane nothing else differs: 1.2e-7 m and 1.2e-6 rad were measured after 0.4 s. On height
# fields the collision routines differ too, a sphere that meets an edge between two triangles touches a little earlier
# or deeper, and from then on the motions part: up to 3e-4 m and 5e-3 rad over several starts, while hips swing by
# 0.2 rad. The bounds leave a factor of four and more, since a touch that comes one physics step later changes the rest.
PLANE = (1e-6, 2e-5)  # m, rad
HEIGHT_FIELD = (2e-3, 2e-2)

SPOTS = ((-4.0, 0.0), (4.0, -2.0), (4.0, 3.0))  # level, ramp, bumps; x, y in m


def test_the_robot_moves_alike_on_a_plane(g1_on_plane: mujoco.MjModel) -> None:
    model = g1_on_plane
    qpos = torch.tensor(model.key_qpos[0]).repeat(2, 1)
    compare(model, qpos, *PLANE)


def test_the_robot_moves_alike_on_level_ground_ramp_and_bumps(
    g1_on_height_field: mujoco.MjModel, ground_height: Callable[..., np.ndarray]
) -> None:
    model = g1_on_height_field
    qpos = torch.tensor(model.key_qpos[0]).repeat(len(SPOTS), 1)
    for world, (x, y) in enumerate(SPOTS):
        around = np.linspace(-0.25, 0.25, 11)
        highest = ground_height(x + around[None, :], y + around[:, None]).max()
        qpos[world, :3] += torch.tensor([x, y, highest + 0.01])
    compare(model, qpos, *HEIGHT_FIELD)


def compare(model: mujoco.MjModel, qpos: torch.Tensor, base_bound: float, joint_bound: float) -> None:
    native, warp = (make_simulation(model, len(qpos), backend, "cpu", num_threads=1) for backend in ("native", "warp"))
    sensors = [simulation.read("sensordata") for simulation in (native, warp)]
    for simulation in (native, warp):
        reset(simulation, qpos)
    assert torch.allclose(*sensors, rtol=1e-4, atol=1e-4)

    feet_loaded = torch.zeros(len(qpos), dtype=torch.bool)
    force = model.sensor("robot_force_w").adr[0] + 2
    for k in range(CONTROL_STEPS):
        swing = torch.sin(torch.arange(model.nu) + 0.3 * k) * torch.linspace(0.1, 0.2, len(qpos))[:, None]
        for simulation in (native, warp):
            simulation.state("ctrl").copy_(qpos[:, 7:] + swing)
            simulation.step(DECIMATION)
        feet_loaded |= (sensors[0][:, force] > 50.0) & (sensors[1][:, force] > 50.0)
    difference = (native.state("qpos") - warp.state("qpos")).abs()
    assert difference[:, :3].max() < base_bound
    assert difference[:, 3:].max() < joint_bound
    assert feet_loaded.all()
    assert native.warnings() == warp.warnings() == []
    assert not (native.diverged() | warp.diverged()).any()


def reset(simulation: Simulation, qpos: torch.Tensor) -> None:
    mask = torch.ones(len(qpos), dtype=torch.bool)
    simulation.reset(mask, qpos, torch.zeros(len(qpos), simulation.model.nv))


def test_the_backends_feel_the_same_strongest_contact_of_the_robot_with_itself() -> None:
    """Arms pressed into the trunk at several depths, on the ground; the last robot touches nothing but the ground."""
    spec = UNITREE_G1_SOLID.make_spec()
    add_robot_sensors(spec, UNITREE_G1_SOLID)
    spec.worldbody.add_geom(name=TERRAIN_GEOM, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    add_contact_sensors(spec, UNITREE_G1_SOLID)
    model = spec.compile()
    qpos = torch.tensor(model.key_qpos[0]).repeat(4, 1)
    qpos[:, 2] -= 0.005
    inward = torch.tensor([0.35, 0.45, 0.55, 0.0])
    for side, sign in (("left", -1.0), ("right", 1.0)):
        roll = 7 + UNITREE_G1_SOLID.joint_names.index(f"{side}_shoulder_roll_joint")
        qpos[:3, roll] = sign * (inward[:3] - 0.1 * (side == "right"))
    sensor = model.sensor("self_force")
    forces = []
    for backend in ("native", "warp"):
        simulation = make_simulation(model, len(qpos), backend, "cpu", num_threads=1)
        data = simulation.read("sensordata")
        reset(simulation, qpos)
        forces.append(data[:, sensor.adr[0] : sensor.adr[0] + 3].norm(dim=1))
        assert simulation.warnings() == []
    assert (forces[0][:3] > 10.0).all()
    assert forces[0][3] == forces[1][3] == 0.0
    torch.testing.assert_close(forces[0], forces[1], rtol=0.02, atol=0.1)
