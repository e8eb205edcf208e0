"""Checks of the physics: contacts and motion against C MuJoCo, graphs, buffers, and robots that fall in any pose."""

from __future__ import annotations

import time

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from humoslope.check.finding import Finding, below
from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.mdp.soles import Soles
from humoslope.scene.scene import build_model
from humoslope.sim import Simulation, make_simulation
from humoslope.sim.warp import WarpSimulation
from humoslope.slope import quaternion
from humoslope.terrain.mjcf import add_height_field
from humoslope.terrain.queries import TerrainQueries

CELL, VERTICES, PERIOD = 0.1, 1081, 100
"""A field as large as a training terrain, 108 m; its ground repeats itself after 100 vertices."""
DISTANCES = (0.0, 10.0, 20.0, 40.0)
"""Distances from the field's centre along x and along y, m; half a period more or less."""
PLACES = 32
RADIUS = 0.015
"""Radius of a foot's sphere, m."""
GRADE = 30.0
DEPTHS = (0.001, 0.03)
"""A touch, and a sphere whose centre is in the ground, m."""
SPEED_LIMITS = (0.01, 1.2)
"""Largest difference in velocity after one step at these depths, m/s. A centre in the ground has several ways out that
are nearly as short, and the backends take different ones; with faulty contacts the differences reach 100 m/s."""

PLACE_LIMIT, JOINT_LIMIT = 2e-3, 2e-2
"""Largest differences of a robot's position, m, and of its joints, rad, between the backends after `HOLD` steps."""
HOLD = 40
ROBOTS = 8

Array = NDArray[np.float64]


def check_contacts(device: str) -> list[Finding]:
    """Spheres in flat ground and in a ramp, one step on both backends, near and far from the field's centre."""
    findings = []
    distances = ", ".join(f"{distance:g}" for distance in DISTANCES)
    half, across = 0.5 * CELL * (VERTICES - 1), np.cos(np.radians(GRADE))
    ramp = np.tan(np.radians(GRADE)) * CELL * np.arange(PERIOD)
    for name, profile, cosine in (("flat ground", np.zeros(PERIOD), 1.0), (f"ramp of {GRADE:g} degrees", ramp, across)):
        model = _sphere_on(profile, half)
        for depth, limit in zip(DEPTHS, SPEED_LIMITS, strict=True):
            qpos = _spheres_in(profile, half, depth, cosine)
            velocity = []
            for backend in ("native", "warp"):
                simulation = make_simulation(model, len(qpos), backend, "cpu" if backend == "native" else device)
                _put(simulation, qpos)
                simulation.step(1)
                velocity.append(simulation.state("qvel")[:, :3].double().cpu())
            apart = (velocity[0] - velocity[1]).abs().amax(dim=1).view(len(DISTANCES), PLACES).amax(dim=1)
            measured = ", ".join(f"{float(worst):.2g}" for worst in apart)
            findings.append(
                Finding(
                    f"sphere {1e3 * depth:g} mm in {name}, velocity apart {distances} m from the centre",
                    f"{measured} m/s",
                    f"below {limit:g} m/s",
                    bool((apart < limit).all()),
                )
            )
    return findings


def check_motion(cfg: EnvCfg, device: str) -> list[Finding]:
    """The task's robot in its default pose, held for some steps on the tiles nearest to and farthest from the field's
    centre, on both backends."""
    terrain = cfg.scene.terrain.build()
    model = build_model(cfg.scene.robot, terrain, cfg.sim.timestep, cfg.sim.cone)
    origins = terrain.tile_origin.reshape(-1, 3)
    order = np.argsort(np.linalg.norm(origins[:, :2], axis=1))
    chosen = origins[np.concatenate([order[: ROBOTS // 2], order[-ROBOTS // 2 :]])]
    robot = cfg.scene.robot
    qpos = torch.zeros(len(chosen), model.nq, dtype=torch.float64)
    qpos[:, 0] = torch.tensor(chosen[:, 0] + terrain.spawn_x)
    qpos[:, 1] = torch.tensor(chosen[:, 1])
    qpos[:, 3] = 1.0
    qpos[:, 7:] = torch.tensor(robot.default_joint_pos, dtype=torch.float64)
    soles = Soles(model, robot, torch.device("cpu"))
    points = soles(qpos.float(), quaternion.matrix(qpos[:, 3:7].float()))  # [N, P, 3] from the root
    ground = TerrainQueries(terrain, torch.device("cpu")).height(qpos[:, None, :2].float() + points[:, :, :2])
    qpos[:, 2] = (ground - points[:, :, 2]).amax(dim=1).double()
    ends = []
    for backend in ("native", "warp"):
        where = "cpu" if backend == "native" else device
        simulation = make_simulation(model, len(qpos), backend, where, nconmax=cfg.sim.nconmax, njmax=cfg.sim.njmax)
        _put(simulation, qpos)
        simulation.state("ctrl").copy_(qpos[:, 7:])
        simulation.step(HOLD)
        ends.append(simulation.state("qpos").double().cpu())
    apart = (ends[0] - ends[1]).abs()
    findings = []
    for name, rows in (("nearest", slice(None, ROBOTS // 2)), ("farthest", slice(ROBOTS // 2, None))):
        subject = f"robot on the {name} tiles, {HOLD * cfg.sim.timestep:g} s"
        findings.append(below(f"{subject}, place apart", float(apart[rows, :3].max()), PLACE_LIMIT, "m"))
        findings.append(below(f"{subject}, joints apart", float(apart[rows, 7:].max()), JOINT_LIMIT, "rad"))
    return findings


def check_graphs(cfg: EnvCfg, device: str) -> list[Finding]:
    """The same run captured and launched kernel by kernel; arrays change place after the capture."""
    model = build_model(cfg.scene.robot, cfg.scene.terrain.build(), cfg.sim.timestep, cfg.sim.cone)
    ends, seconds, captured = [], [], True
    for captures in (True, False):
        simulation = make_simulation(model, 4, "warp", device, nconmax=cfg.sim.nconmax, njmax=cfg.sim.njmax)
        assert isinstance(simulation, WarpSimulation)
        captured = captured and (simulation.captures or not captures)
        simulation.captures = simulation.captures and captures
        qpos = torch.zeros(4, model.nq)
        qpos[:, 2], qpos[:, 3] = 20.0, 1.0  # in the air
        _put(simulation, qpos)
        simulation.step(2)
        simulation.expand("body_mass")[1] *= 1.5
        simulation.recompute_constants()
        simulation.state("ctrl").copy_(0.3 * torch.arange(4.0)[:, None].expand(4, model.nu))
        simulation.step(2)
        seconds.append(_seconds(simulation, 10))
        ends.append(simulation.state("qpos").cpu())
    return [
        Finding("graph capture", "works" if captured else "no memory pools", "works", captured),
        below("captured and direct run apart", float((ends[0] - ends[1]).abs().max()), 1e-4, "m, rad"),
        below("captured step, of a direct one", seconds[0] / seconds[1], 0.8, "of the time"),
    ]


def check_rollout(env: ManagerBasedRlEnv, steps: int) -> list[Finding]:
    """Random actions for a while: no buffer overflows, no world explodes, no reward is absurd."""
    low = torch.zeros((), device=env.device)
    diverged = torch.zeros((), dtype=torch.int64, device=env.device)
    env.sim.warnings()
    with torch.inference_mode():
        for _ in range(steps):
            _, reward, _, _ = env.step(0.8 * torch.randn(env.num_envs, env.robot.num_joints, device=env.device))
            low = torch.minimum(low, reward.min())
            diverged = diverged + env.diverged.sum()
    told, count = env.sim.warnings(), int(diverged)
    subject = f"{steps * env.num_envs:,} steps of random actions ({env.sim.backend})"
    return [
        Finding(f"{subject}, full buffers", "; ".join(told) or "none", "none", not told),
        Finding(f"{subject}, diverged", str(count), "0", count == 0),
        Finding(f"{subject}, smallest reward", f"{float(low):.2f}", "above -5", float(low) > -5.0),
    ]


def _sphere_on(profile: Array, half: float) -> mujoco.MjModel:
    row = np.tile(profile, -(-VERTICES // PERIOD))[:VERTICES]
    span = float(np.ptp(row)) or 0.01
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.005
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    add_height_field(spec, "ground", np.tile(row / span, (VERTICES, 1)).astype(np.float32), (half, half, span, 1.0))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="ground")
    sphere = spec.worldbody.add_body()
    sphere.add_freejoint()
    sphere.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS, 0, 0], mass=1)
    return spec.compile()


def _spheres_in(profile: Array, half: float, depth: float, cosine: float) -> Tensor:
    """Poses [distances * places, 7] of spheres, `depth` deep along the normal of the same ground everywhere."""
    local = 1.0 + np.random.default_rng(1).uniform(0.0, 2.0, (PLACES, 2))  # m
    period = PERIOD * CELL
    same = (0.5 * period - half) % period - 0.5 * period  # where a period begins, next to the centre
    xy = np.array(DISTANCES)[:, None, None] * [1, -1] + local * [1, -1] + same
    qpos = np.zeros((len(DISTANCES) * PLACES, 7), dtype=np.float32)
    qpos[:, :2] = xy.reshape(-1, 2)
    along = (qpos[:, 0].astype(np.float64) + half) / CELL % PERIOD
    qpos[:, 2] = np.interp(along, np.arange(PERIOD), profile) + (RADIUS - depth) / cosine
    qpos[:, 3] = 1.0
    return torch.from_numpy(qpos)


def _put(simulation: Simulation, qpos: Tensor) -> None:
    state = simulation.state("qpos")
    everywhere = torch.ones(len(qpos), dtype=torch.bool, device=simulation.device)
    simulation.reset(everywhere, qpos.to(state), torch.zeros(len(qpos), simulation.model.nv).to(state))


def _seconds(simulation: Simulation, steps: int) -> float:
    """Duration of some steps, the first of which may compile or capture."""
    simulation.step(1)
    start = _now(simulation.device)
    simulation.step(steps)
    return _now(simulation.device) - start


def _now(device: torch.device) -> float:
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return time.perf_counter()
