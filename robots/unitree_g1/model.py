"""Unitree G1: constants of the robot, and its `MjSpec` from `g1.urdf`.

The URDF holds what Unitree publishes (frames, masses, limits, shapes). This module adds what a URDF cannot hold:
reflected motor inertia, gains, contact rules and the default pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco

from humoslope.scene.robot import Robot
from humoslope.scene.sensors import SIDES
from robots.unitree_g1.meshes import G1_MESHES

URDF = Path(__file__).with_name("g1.urdf")


@dataclass(frozen=True)
class Drive:
    """Drive of a joint.

    Attributes:
        armature: Reflected inertia at the joint, summed over its motors, kg m^2.
        effort: Largest torque at the joint, summed over its motors, Nm.
    """

    armature: float
    effort: float

    @property
    def stiffness(self) -> float:
        """Position gain that gives the bare armature a natural frequency of 10 Hz, Nm/rad."""
        return self.armature * NATURAL_FREQUENCY**2

    @property
    def damping(self) -> float:
        """Velocity gain that damps the bare armature twice critically, Nm s/rad."""
        return 2.0 * DAMPING_RATIO * self.armature * NATURAL_FREQUENCY

    @property
    def action_scale(self) -> float:
        """Joint offset at which the spring alone gives a quarter of the largest torque, rad."""
        return 0.25 * self.effort / self.stiffness


NATURAL_FREQUENCY = 2.0 * math.pi * 10.0  # rad/s
DAMPING_RATIO = 2.0  # the limb adds inertia to the armature, so the joint itself ends up less damped than this

# Unitree's motors by their published names.
M7520_14 = Drive(armature=0.01017752, effort=88.0)
M7520_22 = Drive(armature=0.025101925, effort=139.0)
M5020 = Drive(armature=0.00360972, effort=25.0)
M4010 = Drive(armature=0.00425, effort=5.0)
M5020_PAIR = Drive(armature=2 * M5020.armature, effort=2 * M5020.effort)  # two motors on a parallel linkage

LEG = {
    "hip_pitch": M7520_14,
    "hip_roll": M7520_22,
    "hip_yaw": M7520_14,
    "knee": M7520_22,
    "ankle_pitch": M5020_PAIR,
    "ankle_roll": M5020_PAIR,
}
WAIST = {"waist_yaw": M7520_14, "waist_roll": M5020_PAIR, "waist_pitch": M5020_PAIR}
ARM = {
    "shoulder_pitch": M5020,
    "shoulder_roll": M5020,
    "shoulder_yaw": M5020,
    "elbow": M5020,
    "wrist_roll": M5020,
    "wrist_pitch": M4010,
    "wrist_yaw": M4010,
}

# In the order of Unitree's SDK: left leg, right leg, waist, left arm, right arm.
DRIVES = {
    **{f"{side}_{part}_joint": drive for side in SIDES for part, drive in LEG.items()},
    **{f"{part}_joint": drive for part, drive in WAIST.items()},
    **{f"{side}_{part}_joint": drive for side in SIDES for part, drive in ARM.items()},
}

# Joints away from zero when standing with bent knees, rad.
KNEES_BENT = {
    **{f"{side}_hip_pitch_joint": -0.312 for side in SIDES},
    **{f"{side}_knee_joint": 0.669 for side in SIDES},
    **{f"{side}_ankle_pitch_joint": -0.363 for side in SIDES},
    **{f"{side}_shoulder_pitch_joint": 0.2 for side in SIDES},
    "left_shoulder_roll_joint": 0.2,
    "right_shoulder_roll_joint": -0.2,
    **{f"{side}_elbow_joint": 0.6 for side in SIDES},
}

# Sole centre in the ankle roll link, m: midway along the sole, at the height of the spheres' lowest points.
SOLE_CENTRE = (0.04, 0.0, -0.035)

# name: (body, position in the body, m)
SITES = {
    "imu_in_pelvis": ("pelvis", (0.04525, 0.0, -0.08339)),
    "imu_in_torso": ("torso_link", (-0.03959, -0.00224, 0.14792)),
    "left_foot": ("left_ankle_roll_link", SOLE_CENTRE),
    "right_foot": ("right_ankle_roll_link", SOLE_CENTRE),
}

# Shapes that Unitree publishes and the URDF leaves out, since they only matter for contact of the robot with itself.
# name without its side: (body without its side, radius, start and end of the axis in the body), m
LIMB_SHAPES = {
    "hip_collision": ("hip_roll_link", 0.06, (0.02, 0.0, 0.0, 0.02, 0.0, -0.08)),
    "upper_arm_collision": ("shoulder_yaw_link", 0.035, (0.0, 0.0, -0.08, 0.0, 0.0, 0.05)),
    "wrist_collision": ("wrist_pitch_link", 0.035, (-0.01, 0.0, 0.0, 0.06, 0.0, 0.0)),
}

FOOT_FRICTION = (0.8, 0.005, 0.0001)  # sliding; then torsional and rolling, which condim 3 leaves unused
COLLISION_GROUP = 3
GROUND_BIT, SELF_BIT = 1, 2
VISUAL_GROUP = 2


def make_spec() -> mujoco.MjSpec:
    """Builds the robot on a free joint, with actuators and the `knees_bent` keyframe, without ground or sensors."""
    spec = mujoco.MjSpec.from_string(URDF.read_text(encoding="utf-8"))
    _set_options(spec)
    # Before compiling: a root without joint would become part of the world, and its mass would be lost.
    spec.body(UNITREE_G1.root_body).add_freejoint(name="floating_base")
    for name, (body, pos) in SITES.items():
        spec.body(body).add_site(name=name, pos=pos)
    for body in spec.bodies:
        for geom in body.geoms:
            _set_geom(geom, body.name)
    for name, drive in DRIVES.items():
        _add_drive(spec, name, drive)
    qpos = [0.0, 0.0, UNITREE_G1.default_root_height, 1.0, 0.0, 0.0, 0.0, *UNITREE_G1.default_joint_pos]
    spec.add_key(name="knees_bent", qpos=qpos, ctrl=UNITREE_G1.default_joint_pos)
    return spec


def make_solid_spec() -> mujoco.MjSpec:
    """Builds the robot of `make_spec` with parts that cannot pass through each other.

    Every collision shape meets every other one, except those of neighbours: two bodies of one limb, or a limb and the
    trunk, that have no other shape between them. Their shapes overlap around the joints that connect them, and the
    limits of these joints keep them apart. Upper arm and torso are not excluded: they do not overlap, and the shoulder
    can turn the arm into the torso.

    The shapes of `LIMB_SHAPES` close the gaps of the limbs. They do not meet the ground: thigh, forearm, hand and torso
    next to them do, and every shape over a height field costs time.
    """
    spec = make_spec()
    for side in SIDES:
        for name, (body, radius, fromto) in LIMB_SHAPES.items():
            mirrored = [-x if side == "right" and i % 3 == 1 else x for i, x in enumerate(fromto)]
            spec.body(f"{side}_{body}").add_geom(
                name=f"{side}_{name}",
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                size=[radius, 0.0, 0.0],
                fromto=mirrored,
                group=COLLISION_GROUP,
                contype=0,
                conaffinity=0,
                condim=1,
            )
    shapes = [geom for geom in spec.geoms if geom.group == COLLISION_GROUP]
    for geom in shapes:
        on_ground = geom.conaffinity & GROUND_BIT
        geom.contype, geom.conaffinity = SELF_BIT, SELF_BIT | on_ground
    solid = {geom.parent.name for geom in shapes}
    for body in spec.bodies:
        neighbour = _nearest_above(body, solid)
        if body.name in solid and neighbour is not None and not body.name.endswith("shoulder_yaw_link"):
            spec.add_exclude(bodyname1=neighbour, bodyname2=body.name)
    return spec


def _nearest_above(body: mujoco.MjsBody, names: set[str]) -> str | None:
    """Name of the nearest ancestor of a body that is one of `names`; None if there is none."""
    above = body.parent
    while above is not None and above.name not in names:
        above = above.parent
    return None if above is None else above.name


def _set_options(spec: mujoco.MjSpec) -> None:
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.option.timestep = 0.005
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # With a pyramidal cone a foot slips earlier in some headings than in others, which biases steep slopes.
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 1.0
    spec.option.iterations = 10
    spec.option.ls_iterations = 20


def _set_geom(geom: mujoco.MjsGeom, body: str) -> None:
    """Sets a shape up for drawing or for contact, by its name: only collision shapes have one in the URDF.

    The ground (contype 1, conaffinity 1) touches every collision shape. Of the robot's own pairs only the left shin and
    foot touch the right shin and foot: crossed legs are the usual fault of a gait, and every other pair costs time.
    """
    if not geom.name:
        geom.group, geom.contype, geom.conaffinity = VISUAL_GROUP, 0, 0
        return
    geom.group, geom.contype, geom.conaffinity, geom.condim = COLLISION_GROUP, 0, 1, 1
    if geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER:
        geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE
    if body in ("left_knee_link", "left_ankle_roll_link"):
        geom.contype = 2
    if body in ("right_knee_link", "right_ankle_roll_link"):
        geom.conaffinity = 1 | 2
    if body in UNITREE_G1.foot_bodies:
        # Priority makes the foot's friction the contact's, so that one number sets it whatever the ground.
        geom.condim, geom.priority, geom.friction = 3, 1, FOOT_FRICTION


def _add_drive(spec: mujoco.MjSpec, name: str, drive: Drive) -> None:
    joint = spec.joint(name)
    joint.armature = drive.armature
    joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE  # the actuator has the same limit
    spec.add_actuator(
        name=name,
        target=name,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        gainprm=[drive.stiffness] + [0.0] * 9,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        biasprm=[0.0, -drive.stiffness, -drive.damping] + [0.0] * 7,
        forcelimited=mujoco.mjtLimited.mjLIMITED_TRUE,
        forcerange=[-drive.effort, drive.effort],
    )


UNITREE_G1 = Robot(
    name="unitree_g1",
    make_spec=make_spec,
    urdf=URDF,
    meshes=G1_MESHES,
    root_body="pelvis",
    torso_body="torso_link",
    imu_site="imu_in_pelvis",
    foot_bodies=("left_ankle_roll_link", "right_ankle_roll_link"),
    foot_sites=("left_foot", "right_foot"),
    foot_geoms=(
        tuple(f"left_foot{i}_collision" for i in range(1, 5)),
        tuple(f"right_foot{i}_collision" for i in range(1, 5)),
    ),
    shin_bodies=("left_knee_link", "right_knee_link"),
    joint_names=tuple(DRIVES),
    default_joint_pos=tuple(KNEES_BENT.get(name, 0.0) for name in DRIVES),
    default_root_height=0.757,  # the heels just touch; Unitree starts at 0.76
    action_scale=tuple(drive.action_scale for drive in DRIVES.values()),
    stiffness=tuple(drive.stiffness for drive in DRIVES.values()),
    damping=tuple(drive.damping for drive in DRIVES.values()),
    effort_limit=tuple(drive.effort for drive in DRIVES.values()),
    total_mass=33.341142,
)

UNITREE_G1_SOLID = replace(UNITREE_G1, name="unitree_g1_solid", make_spec=make_solid_spec)
"""The same robot with parts that cannot pass through each other."""
