"""The ticks of a session as a rollout: what the robot said, and where its feet carried it."""

from __future__ import annotations

import hashlib
import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from humoslope.deploy import contract as contracts
from humoslope.deploy import rotation
from humoslope.deploy.contract import Contract
from humoslope.deploy.onboard.kinematics import Kinematics
from humoslope.deploy.onboard.session import Ticks
from humoslope.deploy.onboard.states import Mode
from humoslope.deploy.onboard.urdf import urdf
from humoslope.deploy.quantities import Array
from humoslope.errors import UserError
from humoslope.replay.rollout import Columns, Event, Rollout

CELL, BEYOND, HALF_WIDTH = 0.1, 2.0, 2.0
"""Grid of the ground that is drawn, and how far it reaches beyond the walk and to each side, m."""
LOADED_N = 80.0
"""A foot that carries less, N, may slide or swing."""
FOOTPRINTS_M = 0.4
"""Footprints within this distance along the walk make up the height of the ground there, m."""
SLOPE = math.radians(3.0)
"""Inclination from which on ground counts as a slope, rad."""
STATE_KIND, END_KIND = "state", "end"
"""Kinds of the events."""


def contract_sha256(folder: Path) -> str:
    """Returns the SHA-256 of the contract in an export folder, by which a log says whose it is."""
    return hashlib.sha256((folder / contracts.FILE).read_bytes()).hexdigest()


def to_rollout(folder: Path, contract: Contract, ticks: Ticks, label: str) -> tuple[Rollout, dict[str, Any]]:
    """Returns a session as a rollout, and further arrays for its file (see `save`).

    A robot does not measure where it is: the foot that carries more is taken to stand still, and the ground to be where
    the feet stood. The start is the origin, its heading x. Forces on the feet are those that the legs' torques balance.

    Raises:
        UserError: If the session is too short.
    """
    rows = len(ticks.time) - 1
    if rows < 2:
        raise UserError("the robot was never commanded, so there is no walk to record.")
    dt = contract.timing.control_step_s
    readings = ticks.reading[1:]
    joints = np.array([reading.joint_pos for reading in readings])
    quat = _facing_x(np.array([reading.quat_w for reading in readings]))
    kinematics = Kinematics(folder, contract)
    com, root, loads, soles = (np.zeros((rows, *shape)) for shape in ((3,), (3,), (2, 3), (2, 3)))
    reckoning = _Reckoning(kinematics)
    for row in range(rows):
        kinematics.pose(quat[row], joints[row])
        wrenches = kinematics.wrenches(readings[row].torque)
        com[row], soles[row], loads[row] = kinematics.com(), kinematics.soles(), wrenches[:, :3]
        root[row] = reckoning.add(wrenches)
    modes = ticks.mode[:-1]
    stance = np.argmax(loads[:, :, 2], axis=1)
    root -= [*root[0, :2], (root[0] + soles[0, stance[0]])[2]]
    feet = root[:, None] + soles
    walking = np.array([mode is Mode.WALK for mode in modes])
    ground = _Ground(feet[np.arange(rows), stance][walking if walking.any() else slice(None)])
    rise = ground.rise(root[:, 0])
    velocity: Array = np.asarray(np.gradient(root, dt, axis=0))
    along, slope, bank = _seen_ahead(rotation.yaw(quat), rise, velocity)
    normal = np.stack([-rise, np.zeros(rows), np.ones(rows)], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    anchor = feet[np.arange(rows), stance]
    below = ground.height(root[:, 0])

    def numbers(values: Any) -> NDArray[np.float32]:
        return np.asarray(values, dtype=np.float32)

    columns = Columns(
        time=numbers(dt * np.arange(1, rows + 1)),
        episode=np.zeros(rows, dtype=np.int32),
        root_pos_w=numbers(root),
        root_quat_w=numbers(quat),
        root_lin_vel_w=numbers(velocity),
        root_ang_vel_b=numbers([reading.ang_vel_b for reading in readings]),
        root_lin_vel_t=numbers(along),
        root_height=numbers(root[:, 2] - below),
        joint_pos=numbers(joints),
        joint_vel=numbers([reading.joint_vel for reading in readings]),
        joint_torque=numbers([reading.torque for reading in readings]),
        action=numbers(ticks.action[:-1]),
        command=numbers(ticks.command[:-1]),
        com_pos_w=numbers(root + com),
        com_lin_vel_w=numbers(np.gradient(root + com, dt, axis=0)),
        com_height=numbers(root[:, 2] + com[:, 2] - below),
        com_height_target=numbers(np.full(rows, np.nan)),
        foot_pos_w=numbers(feet),
        foot_force_w=numbers(loads),
        self_force=numbers(np.full(rows, np.nan)),
        reward=numbers(np.zeros((rows, 0))),
        slope=numbers(slope),
        bank=numbers(bank),
        ground_normal_w=numbers(normal),
        uphill=slope > SLOPE,
        downhill=slope < -SLOPE,
        zmp_anchor_w=numbers(anchor),
        zmp_normal_w=numbers(normal),
        zmp_w=numbers(anchor),
        zmp_valid=np.zeros(rows, dtype=np.bool_),
    )
    header = _header(folder, contract, kinematics, ground, label)
    more = {
        "mode": np.array([mode.name for mode in modes]),
        "target": numbers([command.target for command in ticks.sent[:-1]]),
        "stiffness": numbers([command.stiffness for command in ticks.sent[:-1]]),
        "damping": numbers([command.damping for command in ticks.sent[:-1]]),
        "temperature": numbers([reading.temperature for reading in readings]),
        "tick_time": np.array(ticks.time[:-1]) - ticks.time[0],
        "busy_s": numbers(ticks.busy_s[:-1]),
    }
    return Rollout(header, columns, numbers(ground.grid), _events(modes, dt)), more


def _seen_ahead(yaw: Array, rise: Array, velocity: Array) -> tuple[Array, Array, Array]:
    """Returns velocities ahead along the ground, to the left and out of it, [T, 3]; the slope of the ground ahead and
    its bank, positive where it rises to the left, [T] rad.

    Args:
        yaw: [T] headings, rad.
        rise: [T] derivatives of the height along x of ground that is the same across.
        velocity: [T, 3] velocities along x, y and z, m/s.
    """
    cos, sin = np.cos(yaw), np.sin(yaw)
    slope, bank = np.arctan(rise * cos), np.arctan(-rise * sin)
    x, y, up = velocity.T
    ahead, left = x * cos + y * sin, y * cos - x * sin
    along = [ahead * np.cos(slope) + up * np.sin(slope), left, up * np.cos(slope) - ahead * np.sin(slope)]
    return np.stack(along, axis=1), slope, bank


class _Ground:
    """Ground that is the same across, through the places where feet stood, [K, 3]."""

    def __init__(self, stood: Array) -> None:
        self.x0 = CELL * math.floor((stood[:, 0].min() - BEYOND) / CELL)
        count = 1 + math.ceil((stood[:, 0].max() + BEYOND - self.x0) / CELL)
        self._x = self.x0 + CELL * np.arange(count)
        heights = np.full(count, np.nan)
        for i, x in enumerate(self._x):
            near = stood[np.abs(stood[:, 0] - x) <= FOOTPRINTS_M]
            if len(near):
                heights[i] = np.median(near[:, 2])
        known = ~np.isnan(heights)
        self._heights = np.interp(self._x, self._x[known], heights[known])
        span = stood[:, 0].max() - stood[:, 0].min()
        fit = np.polyfit(stood[:, 0], stood[:, 2], 1)[0] if span > 1.0 else 0.0
        self.grade_deg = math.degrees(math.atan(float(fit)))
        self.grid = np.repeat(self._heights[:, None], 1 + round(2.0 * HALF_WIDTH / CELL), axis=1)
        self.length = CELL * (count - 1)

    def height(self, x: Array) -> Array:
        """Height at x, m."""
        return np.interp(x, self._x, self._heights)

    def rise(self, x: Array) -> Array:
        """Derivative of the height along x."""
        return np.interp(x, self._x, np.gradient(self._heights, CELL))


def _facing_x(quat: Array) -> Array:
    """Turns orientations [T, 4] about the vertical so that the first one faces along x."""
    yaw = float(rotation.yaw(quat[0]))
    back, turned = np.array([math.cos(-0.5 * yaw), 0.0, 0.0, math.sin(-0.5 * yaw)]), np.zeros_like(quat)
    for row in range(len(quat)):
        mujoco.mju_mulQuat(turned[row], back, quat[row] / np.linalg.norm(quat[row]))
    return turned


class _Reckoning:
    """The way of the root if feet that carry it roll over the ground and do not slide.

    Between two instants, the part of the sole where the ground presses stands still; two loaded feet are weighted by
    what they carry. While neither foot carries anything, the root moves on as before.

    Args:
        kinematics: The robot.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        self._kinematics = kinematics
        self._root, self._step = np.zeros(3), np.zeros(3)
        self._before: tuple[Array, Array, Array] | None = None

    def add(self, wrenches: Array) -> Array:
        """Returns the position of the root [3], m, at the next instant, in which `kinematics` is posed.

        Args:
            wrenches: [2, 6] of the ground on the feet.
        """
        pos, turned = self._kinematics.feet_poses()
        if self._before is not None:
            old_pos, old_turned, old_wrenches = self._before
            steps, weights = [], []
            for foot in range(2):
                load = min(wrenches[foot, 2], old_wrenches[foot, 2])
                if load < LOADED_N:
                    continue
                mean = 0.5 * (wrenches[foot] + old_wrenches[foot])
                at = self._kinematics.pressed(mean, turned[foot], foot)
                steps.append(old_pos[foot] + old_turned[foot] @ at - pos[foot] - turned[foot] @ at)
                weights.append(load)
            if steps:
                self._step = np.average(steps, axis=0, weights=weights)
            self._root = self._root + self._step
        self._before = pos, turned, wrenches.copy()
        return self._root


def _header(folder: Path, contract: Contract, kinematics: Kinematics, ground: _Ground, label: str) -> dict[str, Any]:
    training, joints = contract.training, contract.joints
    harness = "without the harness" if not training.harness else f"with the harness at {training.harness:g}"
    return {
        "task": training.task,
        "label": label,
        "checkpoint": {
            "path": training.checkpoint,
            "sha256": training.sha256,
            "iteration": training.iteration,
            "total_steps": training.environment_steps,
            "training": training.origin or f"training ended {harness}",
        },
        "code": contract.exported_by,
        "recorded": datetime.now(UTC).isoformat(timespec="seconds"),
        "physics": {"backend": "robot", "timestep": contract.timing.physics_step_s, "decimation": contract.decimation},
        "dt": contract.timing.control_step_s,
        "protocol": {"contract_sha256": contract_sha256(folder)},
        "robot": {
            "name": contract.robot.name,
            "urdf": urdf(kinematics.model, contract.robot.root_body, contract.robot.name),
            "root": contract.robot.root_body,
            "joint_names": [joint.name for joint in joints],
            "default_joint_pos": [joint.default_rad for joint in joints],
            "action_scale": [joint.action_scale_rad for joint in joints],
            "effort_limit": [joint.effort_limit_nm for joint in joints],
        },
        "reward_terms": [],
        "terrain": {
            "name": "as the feet found it",
            "grade": ground.grade_deg,
            "cell": CELL,
            "origin": [ground.x0, -HALF_WIDTH],
            "tile_origin": [ground.x0, 0.0, 0.0],
            "tile_length": ground.length,
            "tile_width": 2.0 * HALF_WIDTH,
        },
    }


def _events(modes: list[Mode], dt: float) -> tuple[Event, ...]:
    changes = [row for row in range(len(modes)) if row == 0 or modes[row] is not modes[row - 1]]
    return tuple(
        Event(dt * (row + 1), END_KIND if modes[row] is Mode.DAMPING else STATE_KIND, modes[row].words)
        for row in changes
    )
