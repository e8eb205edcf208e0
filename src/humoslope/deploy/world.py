"""One robot in plain MuJoCo: the model of an export, actuators as the contract defines them, and ground."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from humoslope.deploy import rotation
from humoslope.deploy.conditions import NOMINAL, Conditions
from humoslope.deploy.contract import Contract
from humoslope.deploy.controller import read_hashed
from humoslope.deploy.gait import FOOT_DOWN_N
from humoslope.deploy.quantities import Array, Measured
from humoslope.errors import UserError, unknown

RUN_UP = 0.75
"""Length of level ground between the start and a ramp, m; as in the ramp check."""
BEHIND, HALF_WIDTH, HALF_THICKNESS = 20.0, 20.0, 0.5
"""Length of level ground behind the start, and half extents of the slabs that make up a ramp, m."""
GROUND = "ground"
TOUCH_N = 1.0
"""Two parts of the robot touch while they press on each other with at least this normal force, N; as in training."""
CLEARANCE = 0.01
"""Height of the feet above the ground at the start, m."""
ROUNDING = 1e-6
"""Fraction of a physics step that is rounding, not age."""
CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
PHYSICS = (
    *("integrator", "cone", "jacobian", "solver", "iterations", "ls_iterations", "tolerance", "ls_tolerance"),
    *("impratio", "gravity", "wind", "density", "viscosity", "disableflags", "enableflags"),
)
"""Options of the physics that hold for every robot model of an export, in addition to the time step."""
State = tuple[Array, Array]
"""Positions and velocities, as MuJoCo has them."""


class World:
    """A robot that starts at the origin and faces along x.

    Attributes:
        model: MuJoCo's model.
        data: MuJoCo's data.
        grade: Grade of the ramp, rad; positive rises along x.
        cross: Slope across the course, rad; positive rises to the left.
        foot_bodies: Ids of the bodies that carry the foot geoms, one for each foot.
        free_pos: Index in `data.qpos` at which the pose of the root begins.
        free_vel: Index in `data.qvel` at which the velocity of the root begins.

    Args:
        folder: The export folder.
        contract: The contract in it.
        grade: Grade of the ramp, degrees; 0 for flat ground.
        friction: Coefficient of friction between feet and ground.
        length: Length of the ramp, m.
        cross: Slope of the whole ground across the course, degrees; 0 if there is a ramp.
        conditions: Disturbances.
        model: MJCF of another robot with joints of the same names, in place of the export's own; it walks with the
            motors and the physics options of the export.
        run_up: Whether a ramp begins `RUN_UP` ahead of a start on level ground. Else all of the ground has its grade.

    Raises:
        UserError: If the model is missing, broken, or lacks what the contract names, or if the conditions do not go
            with the contract.
    """

    def __init__(
        self,
        folder: Path,
        contract: Contract,
        grade: float,
        friction: float,
        length: float,
        cross: float = 0.0,
        conditions: Conditions = NOMINAL,
        model: Path | None = None,
        run_up: bool = True,
    ) -> None:
        self._contract, self.grade, self.cross = contract, math.radians(grade), math.radians(cross)
        self._ramp = run_up and grade != 0.0  # else the ground is one plane
        self._set_timing(conditions)
        self._bias = _encoder_bias(contract, conditions)
        tilt = np.array([*conditions.imu_tilt_rad, 0.0])
        angle = float(np.linalg.norm(tilt))
        self._imu_quat: Array | None = None  # orientation of the IMU in the root frame
        if angle:
            self._imu_quat = np.zeros(4)
            mujoco.mju_axisAngle2Quat(self._imu_quat, tilt / angle, angle)

        spec = _load(folder / contract.robot.file, contract.robot.sha256)
        feet = [_named(spec.geom(name), "geom", name, spec.geoms) for name in contract.robot.foot_geoms]
        if model is not None:
            spec, feet = _other_robot(model, spec, feet, contract)
        root = _named(spec.body(contract.robot.root_body), "body", contract.robot.root_body, spec.bodies)
        floating = root.first_joint()
        if floating is None or floating.type != mujoco.mjtJoint.mjJNT_FREE:
            raise UserError(f"the robot model's body '{root.name}' has no free joint, so it cannot walk.")
        _add_drives(spec, contract, conditions.strength)
        for foot in feet:
            foot.friction[0] = friction if conditions.friction is None else conditions.friction
        foot_geoms = [foot.name for foot in feet]
        if self._ramp:
            _add_ramp(spec, self.grade, length)
        else:
            _add_plane(spec, self.grade, self.cross)
        if conditions.load_kg:
            _named(spec.body(conditions.load_body), "body", conditions.load_body, spec.bodies)
        spec.option.timestep = self._timestep
        try:
            self.model = spec.compile()
        except ValueError as error:
            raise UserError(f"the robot model does not go with the contract: {_line(error)}.") from None
        self.data = mujoco.MjData(self.model)
        free = self.model.joint(self.model.body(contract.robot.root_body).jntadr[0])
        joints = [self.model.joint(joint.name) for joint in contract.joints]
        self.free_pos, self.free_vel = int(free.qposadr[0]), int(free.dofadr[0])
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        self._qvel = np.array([joint.dofadr[0] for joint in joints])
        self._default = np.array([joint.default_rad for joint in contract.joints])
        foot_bodies = [int(self.model.geom(name).bodyid[0]) for name in foot_geoms]
        self.foot_bodies = sorted(set(foot_bodies))
        self._foot_of_geom = {
            int(self.model.geom(name).id): self.foot_bodies.index(body)
            for name, body in zip(foot_geoms, foot_bodies, strict=True)
        }
        if conditions.load_kg:
            self.model.body_mass[self.model.body(conditions.load_body).id] += conditions.load_kg
            mujoco.mj_setConst(self.model, self.data)  # whatever MuJoCo derives from masses
        # The contract's height is that of its own robot over level ground.
        self._place_on_feet = cross != 0.0 or (grade != 0.0 and not run_up) or model is not None
        self.reset()

    def _set_timing(self, conditions: Conditions) -> None:
        timing = self._contract.timing
        self._timestep = conditions.timestep_s or timing.physics_step_s
        self._decimation = round(timing.control_step_s / self._timestep)
        if self._decimation < 1 or abs(self._decimation * self._timestep - timing.control_step_s) > 1e-9:
            raise UserError(
                f"conditions: the control step of {timing.control_step_s:g} s is no whole number of physics steps of "
                f"{self._timestep:g} s."
            )
        self._delay = round(conditions.delay_s / self._timestep)  # physics steps
        # Where the robot is, and what it measures of itself, belong to these numbers of physics steps ago.
        self._place_age, self._sensor_age = (
            age / self._timestep for age in (timing.physics_step_s, timing.observation_age_s)
        )
        self._kept = math.ceil(max(self._place_age, self._sensor_age) - ROUNDING)

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
        height = self._contract.robot.default_root_height_m + self.ground(x, y) + CLEARANCE
        pose = [x, y, height, math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)]
        data.qpos[self.free_pos : self.free_pos + 7] = pose
        low, high = np.array([joint.range_rad for joint in self._contract.joints]).T
        data.qpos[self._qpos] = np.clip(self._default + joints, low, high)
        mujoco.mj_forward(model, data)
        if self._place_on_feet:
            data.qpos[self.free_pos + 2] += CLEARANCE - self._clearance()
            mujoco.mj_forward(model, data)
        data.ctrl[:] = self._default - self._bias
        self._steps_done = 0
        self._underway: deque[tuple[int, Array]] = deque()  # targets, each with the physics step of its effect
        self._take_state()

    def _clearance(self) -> float:
        """Height of the lowest corner of the feet's bounding boxes above the ground, m."""
        lowest = math.inf
        for geom in self._foot_of_geom:
            centre, half = self.model.geom_aabb[geom].reshape(2, 3)
            corners = self.data.geom_xpos[geom] + (centre + half * CORNERS) @ self.data.geom_xmat[geom].reshape(3, 3).T
            lowest = min(lowest, *(z - self.ground(x, y) for x, y, z in corners))
        return lowest

    def step(self, target: Array) -> None:
        """Advances by one control step with joint targets `target` [J], rad."""
        # The motors compare targets with encoders.
        self._underway.append((self._steps_done + self._delay, target - self._bias))
        for left in range(self._decimation, 0, -1):
            while self._underway and self._underway[0][0] <= self._steps_done:
                self.data.ctrl[:] = self._underway.popleft()[1]
            if left <= self._kept:
                self._past.appendleft(self._state())
            mujoco.mj_step(self.model, self.data)
            self._steps_done += 1
        self._look()

    def push(self, velocity_w: Array) -> None:
        """Adds a velocity [3], m/s, to the whole robot."""
        self.data.qvel[self.free_vel : self.free_vel + 3] += velocity_w

    def _take_state(self) -> None:
        """Takes the present state for that of all times before."""
        self._past: deque[State] = deque([self._state()] * self._kept, self._kept)  # the newest first
        self._look()

    def look_now(self) -> None:
        """Makes the present state the one that is seen."""
        self._seen_pos, self._seen_vel = self._sensed_pos, self._sensed_vel = self._state()

    def _state(self) -> State:
        return self.data.qpos.copy(), self.data.qvel.copy()

    def _look(self) -> None:
        self._seen_pos, self._seen_vel = self._state_before(self._place_age)
        self._sensed_pos, self._sensed_vel = (
            (self._seen_pos, self._seen_vel)
            if self._sensor_age == self._place_age
            else self._state_before(self._sensor_age)
        )

    def _state_before(self, steps: float) -> State:
        """Returns the state so many physics steps ago, interpolated between the two around it."""
        whole = math.floor(steps + ROUNDING)
        part = steps - whole
        newer_pos, newer_vel = self._past[whole - 1] if whole else self._state()
        if part <= ROUNDING:
            return newer_pos, newer_vel
        older_pos, older_vel = self._past[whole]
        way, pos = np.zeros(self.model.nv), newer_pos.copy()
        mujoco.mj_differentiatePos(self.model, way, 1.0, newer_pos, older_pos)
        mujoco.mj_integratePos(self.model, pos, way, part)
        return pos, newer_vel + part * (older_vel - newer_vel)

    def measured(self, command: Array, last_action: Array) -> Measured:
        """Returns the measurements of the instant that the contract prescribes."""
        i, j = self.free_pos, self.free_vel
        quat, ang_vel = self._sensed_pos[i + 3 : i + 7], self._sensed_vel[j + 3 : j + 6]
        velocity, back = np.zeros(3), np.zeros(4)
        mujoco.mju_negQuat(back, quat)
        mujoco.mju_rotVecQuat(velocity, self._sensed_vel[j : j + 3], back)
        if self._imu_quat is not None:
            true_quat, true_ang_vel = quat, ang_vel
            quat, ang_vel = np.zeros(4), np.zeros(3)
            mujoco.mju_mulQuat(quat, true_quat, self._imu_quat)
            mujoco.mju_negQuat(back, self._imu_quat)
            mujoco.mju_rotVecQuat(ang_vel, true_ang_vel, back)
        return Measured(
            root_quat_w=quat,
            root_ang_vel_b=ang_vel,  # MuJoCo keeps a free joint's rotation in its body's frame
            joint_pos_rel=self._sensed_pos[self._qpos] - self._default + self._bias,
            joint_vel=self._sensed_vel[self._qvel],
            command=command,
            last_action=last_action,
            root_lin_vel_b=velocity,
        )

    @property
    def joint_pos(self) -> Array:
        """Joint positions [J], rad, in the order of the contract; the true ones of this instant."""
        return self.data.qpos[self._qpos]

    @property
    def root_pos(self) -> Array:
        """Position of the root [3], m, one physics step of the contract ago, like all that is no measurement."""
        return self._seen_pos[self.free_pos : self.free_pos + 3]

    @property
    def yaw(self) -> float:
        """Heading of the root, rad."""
        return float(rotation.yaw(self._seen_quat))

    @property
    def _seen_quat(self) -> Array:
        return self._seen_pos[self.free_pos + 3 : self.free_pos + 7]

    def ground(self, x: float, y: float = 0.0) -> float:
        """Returns the height of the ground at x and y, m."""
        rise = max(x - RUN_UP, 0.0) if self._ramp else x
        return math.tan(self.grade) * rise + math.tan(self.cross) * y

    def along(self, x: float) -> float:
        """Returns the distance along the ground from the origin to x, m."""
        level = min(x, RUN_UP) if self._ramp else 0.0
        return level + (x - level) / math.cos(self.grade)

    def feet_down(self) -> NDArray[np.bool_]:
        """Returns for each of `foot_bodies` whether the ground carries it, [F]."""
        return self.foot_forces() >= FOOT_DOWN_N

    def foot_forces(self) -> Array:
        """Returns the normal force of the ground on each of `foot_bodies`, [F] N."""
        force, wrench = np.zeros(len(self.foot_bodies)), np.zeros(6)
        for i, contact in enumerate(self.data.contact):
            for geom in contact.geom:
                foot = self._foot_of_geom.get(int(geom))
                if foot is not None:
                    mujoco.mj_contactForce(self.model, self.data, i, wrench)
                    force[foot] += wrench[0]
        return force

    def touches_itself(self) -> bool:
        """Returns whether two parts of the robot press on each other with at least `TOUCH_N`."""
        wrench = np.zeros(6)
        for i, contact in enumerate(self.data.contact):
            if self.model.geom_bodyid[contact.geom].all():  # the ground belongs to the world, body 0
                mujoco.mj_contactForce(self.model, self.data, i, wrench)
                if wrench[0] >= TOUCH_N:
                    return True
        return False

    def fallen(self) -> bool:
        """Returns whether the robot has fallen as the contract defines it, or the physics has diverged."""
        fall, warnings = self._contract.fall, self.data.warning
        bad = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
        if any(warnings[kind].number for kind in (*bad, mujoco.mjtWarning.mjWARN_BADCTRL)):
            return True
        x, y, z = self.root_pos
        upright = rotation.up_b(self._seen_quat)[2]
        too_low = fall.root_height_below_m is not None and z - self.ground(x, y) < fall.root_height_below_m
        tilted = fall.tilt_above_deg is not None and upright < math.cos(math.radians(fall.tilt_above_deg))
        return bool(too_low or tilted)


def _load(path: Path, sha256: str | None) -> mujoco.MjSpec:
    content = read_hashed(path, sha256, "robot model")
    try:
        return mujoco.MjSpec.from_string(content.decode("utf-8"))
    except ValueError as error:
        raise UserError(f"'{path}' is no MuJoCo model: {_line(error)}.") from None


def _other_robot(
    path: Path, own: mujoco.MjSpec, own_feet: Sequence[Any], contract: Contract
) -> tuple[mujoco.MjSpec, list[Any]]:
    """Loads another robot model, without what the export brings along; returns it with the geoms of its feet.

    Its feet are the geoms that collide of the bodies that have the same names as the export's.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise UserError(f"'{path}' is no MuJoCo model: {_line(error)}.") from None
    # A floating base counts as no joint here: it is checked for by itself, and may have any name.
    have = {joint.name for joint in spec.joints if joint.type != mujoco.mjtJoint.mjJNT_FREE}
    want = {joint.name for joint in contract.joints}
    if have != want:
        differences = [
            f"{verb} {', '.join(repr(name) for name in sorted(names)[:3])}{f' and {n - 3} more' if n > 3 else ''}"
            for verb, names in (("lacks", want - have), ("adds", have - want))
            if (n := len(names))
        ]
        raise UserError(f"the joints of robot model '{path}' are not the policy's: it {' and '.join(differences)}.")
    for element in (*spec.sensors, *spec.actuators, *spec.keys, *spec.worldbody.geoms):
        spec.delete(element)
    for name in PHYSICS:
        setattr(spec.option, name, getattr(own.option, name))
    feet = []
    for body in dict.fromkeys(foot.parent.name for foot in own_feet):
        geoms = _named(spec.body(body), "body", body, spec.bodies).geoms
        solid = [geom for geom in geoms if geom.contype or geom.conaffinity]
        if not solid:
            raise UserError(f"body '{body}' of robot model '{path}' has no geom that collides, so it is no foot.")
        feet += solid
    for i, foot in enumerate(feet):
        foot.name = foot.name or f"foot_geom_{i}"
        foot.priority, foot.condim = own_feet[0].priority, own_feet[0].condim  # its friction is the contact's
    return spec, feet


def _encoder_bias(contract: Contract, conditions: Conditions) -> Array:
    bias, joints = conditions.encoder_bias_rad, len(contract.joints)
    if bias and len(bias) != joints:
        raise UserError(f"conditions: encoder_bias_rad has {len(bias)} entries for {joints} joints.")
    return np.array(bias or [0.0] * joints)


def _line(error: Exception) -> str:
    return " ".join(str(error).split())


def _named(element: Any, kind: str, name: str, known: Iterable[Any]) -> Any:
    """Returns `element`, which was looked up by `name`; raises UserError if it is None."""
    if element is None:
        raise unknown(f"the robot model's {kind}", name, (other.name for other in known if other.name))
    return element


def _add_drives(spec: mujoco.MjSpec, contract: Contract, strength: float) -> None:
    """Adds position actuators with the contract's gains and limits times `strength`, in its order.

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
            gainprm=[strength * joint.stiffness_nm_rad] + [0.0] * 9,
            biastype=mujoco.mjtBias.mjBIAS_AFFINE,
            biasprm=[0.0, -strength * joint.stiffness_nm_rad, -strength * joint.damping_nms_rad] + [0.0] * 7,
            forcelimited=mujoco.mjtLimited.mjLIMITED_TRUE,
            forcerange=[-strength * joint.effort_limit_nm, strength * joint.effort_limit_nm],
        )


def _add_plane(spec: mujoco.MjSpec, grade: float, cross: float) -> None:
    """Adds a plane through the origin that rises along x by `grade` or to the left by `cross`, rad."""
    # One of the angles is 0, so the order of the two rotations does not matter.
    quat = [math.cos(0.5 * cross) * math.cos(0.5 * grade), math.sin(0.5 * cross), -math.sin(0.5 * grade), 0.0]
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0], quat=quat, **_ground_properties(spec)
    )


def _add_ramp(spec: mujoco.MjSpec, grade: float, length: float) -> None:
    """Adds a level slab up to `RUN_UP` and a tilted one from there."""
    shared = _ground_properties(spec)
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


def _ground_properties(spec: mujoco.MjSpec) -> dict[str, Any]:
    """Adds a light and a chequered material; returns what all geoms of the ground have in common."""
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
    return {"contype": 1, "conaffinity": 1, "condim": 3, "material": GROUND}
