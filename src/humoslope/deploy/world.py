"""One robot in plain MuJoCo: the model of an export, actuators as the contract defines them, and ground."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from humoslope.deploy.contract import Contract
from humoslope.deploy.controller import read_hashed
from humoslope.deploy.quantities import Array, Measured
from humoslope.errors import UserError, unknown

RUN_UP = 0.75
"""Length of level ground between the start and a ramp, m; as in the ramp check."""
BEHIND, HALF_WIDTH, HALF_THICKNESS = 20.0, 20.0, 0.5
"""Length of level ground behind the start, and half extents of the slabs that make up a ramp, m."""
GROUND = "ground"
FOOT_DOWN_N = 5.0
"""A foot is down while the ground carries it with at least this normal force, N."""


class World:
    """A robot that starts at the origin and faces along x.

    Attributes:
        model: MuJoCo's model.
        data: MuJoCo's data.
        grade: Grade of the ramp, rad; positive rises along x.
        foot_bodies: Ids of the bodies that carry the foot geoms, one for each foot.

    Args:
        folder: The export folder.
        contract: The contract in it.
        grade: Grade of the ramp, degrees; 0 for flat ground.
        friction: Coefficient of friction between feet and ground.
        length: Length of the ramp, m.

    Raises:
        UserError: If the model is missing, broken, or lacks what the contract names.
    """

    def __init__(self, folder: Path, contract: Contract, grade: float, friction: float, length: float) -> None:
        self._contract, self.grade = contract, math.radians(grade)
        spec = _load(folder / contract.robot.file, contract.robot.sha256)
        root = _named(spec.body(contract.robot.root_body), "body", contract.robot.root_body, spec.bodies)
        floating = root.first_joint()
        if floating is None or floating.type != mujoco.mjtJoint.mjJNT_FREE:
            raise UserError(f"the robot model's body '{root.name}' has no free joint, so it cannot walk.")
        _add_drives(spec, contract)
        for name in contract.robot.foot_geoms:
            _named(spec.geom(name), "geom", name, spec.geoms).friction[0] = friction
        _add_ground(spec, self.grade, length)
        spec.option.timestep = contract.timing.physics_step_s
        try:
            self.model = spec.compile()
        except ValueError as error:
            raise UserError(f"the robot model does not go with the contract: {_line(error)}.") from None
        self.data = mujoco.MjData(self.model)
        free = self.model.joint(self.model.body(contract.robot.root_body).jntadr[0])
        joints = [self.model.joint(joint.name) for joint in contract.joints]
        self._free_pos, self._free_vel = int(free.qposadr[0]), int(free.dofadr[0])
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        self._qvel = np.array([joint.dofadr[0] for joint in joints])
        self._default = np.array([joint.default_rad for joint in contract.joints])
        feet = [int(self.model.geom(name).bodyid[0]) for name in contract.robot.foot_geoms]
        self.foot_bodies = sorted(set(feet))
        self._foot_of_geom = {
            int(self.model.geom(name).id): self.foot_bodies.index(body)
            for name, body in zip(contract.robot.foot_geoms, feet, strict=True)
        }
        self.reset()

    def reset(self, x: float = 0.0, y: float = 0.0, yaw: float = 0.0, joints: Array | float = 0.0) -> None:
        """Places the robot at rest in its default pose, a centimetre above the ground.

        Args:
            x: Position along the course, m.
            y: Position across the course, m.
            yaw: Heading, rad.
            joints: [J] offset from the default pose, rad; clipped to the joints' ranges.
        """
        model, data = self.model, self.data
        mujoco.mj_resetData(model, data)
        height = self._contract.robot.default_root_height_m + self.ground(x) + 0.01
        pose = [x, y, height, math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)]
        data.qpos[self._free_pos : self._free_pos + 7] = pose
        low, high = np.array([joint.range_rad for joint in self._contract.joints]).T
        data.qpos[self._qpos] = np.clip(self._default + joints, low, high)
        mujoco.mj_forward(model, data)
        data.ctrl[:] = self._default
        self._take_state()

    def step(self, target: Array) -> None:
        """Advances by one control step with joint targets `target` [J], rad."""
        self.data.ctrl[:] = target
        mujoco.mj_step(self.model, self.data, self._contract.decimation - 1)
        # The contract's observations belong to the last computed forces: one physics step before the new targets.
        self._take_state()
        mujoco.mj_step(self.model, self.data)

    def _take_state(self) -> None:
        self._seen_pos, self._seen_vel = self.data.qpos.copy(), self.data.qvel.copy()

    def measured(self, command: Array, last_action: Array) -> Measured:
        """Returns the measurements of the instant that the contract prescribes."""
        i, j = self._free_pos, self._free_vel
        return Measured(
            root_quat_w=self._seen_pos[i + 3 : i + 7],
            root_ang_vel_b=self._seen_vel[j + 3 : j + 6],  # MuJoCo keeps a free joint's rotation in its body's frame
            joint_pos_rel=self._seen_pos[self._qpos] - self._default,
            joint_vel=self._seen_vel[self._qvel],
            command=command,
            last_action=last_action,
        )

    @property
    def root_pos(self) -> Array:
        """Position of the root [3], m, at the instant of the measurements."""
        return self._seen_pos[self._free_pos : self._free_pos + 3]

    @property
    def yaw(self) -> float:
        """Heading of the root, rad."""
        w, x, y, z = self._seen_pos[self._free_pos + 3 : self._free_pos + 7]
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    def ground(self, x: float) -> float:
        """Returns the height of the ground at x, m."""
        return math.tan(self.grade) * max(x - RUN_UP, 0.0)

    def along(self, x: float) -> float:
        """Returns the distance along the ground from the origin to x, m."""
        return min(x, RUN_UP) + max(x - RUN_UP, 0.0) / math.cos(self.grade)

    def feet_down(self) -> NDArray[np.bool_]:
        """Returns for each of `foot_bodies` whether the ground carries it, [F]."""
        force, wrench = np.zeros(len(self.foot_bodies)), np.zeros(6)
        for i, contact in enumerate(self.data.contact):
            for geom in contact.geom:
                foot = self._foot_of_geom.get(int(geom))
                if foot is not None:
                    mujoco.mj_contactForce(self.model, self.data, i, wrench)
                    force[foot] += wrench[0]
        return force >= FOOT_DOWN_N

    def fallen(self) -> bool:
        """Returns whether the robot has fallen as the contract defines it, or the physics has diverged."""
        fall, warnings = self._contract.fall, self.data.warning
        bad = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
        if any(warnings[kind].number for kind in (*bad, mujoco.mjtWarning.mjWARN_BADCTRL)):
            return True
        x, _, z = self.root_pos
        _, qx, qy, _ = self._seen_pos[self._free_pos + 3 : self._free_pos + 7]
        upright = 1.0 - 2.0 * (qx * qx + qy * qy)
        too_low = fall.root_height_below_m is not None and z - self.ground(x) < fall.root_height_below_m
        tilted = fall.tilt_above_deg is not None and upright < math.cos(math.radians(fall.tilt_above_deg))
        return bool(too_low or tilted)


def _load(path: Path, sha256: str | None) -> mujoco.MjSpec:
    content = read_hashed(path, sha256, "robot model")
    try:
        return mujoco.MjSpec.from_string(content.decode("utf-8"))
    except ValueError as error:
        raise UserError(f"'{path}' is no MuJoCo model: {_line(error)}.") from None


def _line(error: Exception) -> str:
    return " ".join(str(error).split())


def _named(element: Any, kind: str, name: str, known: Iterable[Any]) -> Any:
    """Returns `element`, which was looked up by `name`; raises UserError if it is None."""
    if element is None:
        raise unknown(f"the robot model's {kind}", name, (other.name for other in known if other.name))
    return element


def _add_drives(spec: mujoco.MjSpec, contract: Contract) -> None:
    """Adds position actuators with the contract's gains and limits, in its order.

    Their force is the contract's torque. MuJoCo integrates the damping implicitly, at the end of a step, as in
    training; at 5 ms that slows the joints a little. With torques computed outside, at the start of a step, or with a
    finer step the shipped Stage I walks at 0.6 instead of 0.48 m/s.
    """
    for joint in contract.joints:
        _named(spec.joint(joint.name), "joint", joint.name, spec.joints).armature = joint.armature_kg_m2
        spec.add_actuator(
            name=joint.name,
            target=joint.name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            gaintype=mujoco.mjtGain.mjGAIN_FIXED,
            gainprm=[joint.stiffness_nm_rad] + [0.0] * 9,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            biasprm=[0.0, -joint.stiffness_nm_rad, -joint.damping_nms_rad] + [0.0] * 7,
            forcelimited=mujoco.mjtLimited.mjLIMITED_TRUE,
            forcerange=[-joint.effort_limit_nm, joint.effort_limit_nm],
        )


def _add_ground(spec: mujoco.MjSpec, grade: float, length: float) -> None:
    """Adds a plane, or a level slab up to `RUN_UP` and a tilted one from there."""
    texture = spec.add_texture(
        name=GROUND,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.42, 0.45, 0.48],
        rgb2=[0.50, 0.53, 0.56],
        width=256,
        height=256,
    )
    material = spec.add_material(name=GROUND, texuniform=True, texrepeat=[0.5, 0.5])
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture.name
    spec.worldbody.add_light(pos=[0.0, 0.0, 10.0], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    shared = {"contype": 1, "conaffinity": 1, "condim": 3, "material": GROUND}
    if grade == 0.0:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0], **shared)
        return
    box, half = mujoco.mjtGeom.mjGEOM_BOX, 0.5 * (BEHIND + RUN_UP)
    spec.worldbody.add_geom(
        type=box, size=[half, HALF_WIDTH, HALF_THICKNESS], pos=[RUN_UP - half, 0.0, -HALF_THICKNESS], **shared
    )
    forward, up = (math.cos(grade), math.sin(grade)), (-math.sin(grade), math.cos(grade))  # (x, z) of the ramp's axes
    x, z = (0.5 * length * f - HALF_THICKNESS * u for f, u in zip(forward, up, strict=True))
    spec.worldbody.add_geom(
        type=box,
        size=[0.5 * length, HALF_WIDTH, HALF_THICKNESS],
        pos=[RUN_UP + x, 0.0, z],
        quat=[math.cos(0.5 * grade), 0.0, -math.sin(0.5 * grade), 0.0],
        **shared,
    )
