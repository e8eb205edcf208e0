"""MuJoCo sensors behind the named signals, for any robot's spec."""

from __future__ import annotations

import mujoco
from mujoco import mjtObj, mjtSensor

from humoslope.scene.robot import Robot
from humoslope.terrain.mjcf import TERRAIN_GEOM

SIDES = ("left", "right")
STRONGEST, NET = 2, 3
"""Reductions of a contact sensor: the contact with the largest force, in its own frame; the sum of all contacts, in the
world frame."""


def add_robot_sensors(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Adds the joint, root, centre-of-mass and foot sensors that `Signals` reads by name."""

    def add(name: str, kind: mjtSensor, objtype: mjtObj, objname: str) -> None:
        spec.add_sensor(name=name, type=kind, objtype=objtype, objname=objname)

    for joint in robot.joint_names:
        add(f"joint_pos/{joint}", mjtSensor.mjSENS_JOINTPOS, mjtObj.mjOBJ_JOINT, joint)
    for joint in robot.joint_names:
        add(f"joint_vel/{joint}", mjtSensor.mjSENS_JOINTVEL, mjtObj.mjOBJ_JOINT, joint)
    add("root_pos_w", mjtSensor.mjSENS_FRAMEPOS, mjtObj.mjOBJ_XBODY, robot.root_body)
    add("root_quat_w", mjtSensor.mjSENS_FRAMEQUAT, mjtObj.mjOBJ_XBODY, robot.root_body)
    add("root_lin_vel_w", mjtSensor.mjSENS_FRAMELINVEL, mjtObj.mjOBJ_XBODY, robot.root_body)
    add("root_ang_vel_b", mjtSensor.mjSENS_GYRO, mjtObj.mjOBJ_SITE, robot.imu_site)
    add("torso_quat_w", mjtSensor.mjSENS_FRAMEQUAT, mjtObj.mjOBJ_XBODY, robot.torso_body)
    add("torso_ang_vel_w", mjtSensor.mjSENS_FRAMEANGVEL, mjtObj.mjOBJ_XBODY, robot.torso_body)
    add("com_pos_w", mjtSensor.mjSENS_SUBTREECOM, mjtObj.mjOBJ_BODY, robot.root_body)
    add("com_lin_vel_w", mjtSensor.mjSENS_SUBTREELINVEL, mjtObj.mjOBJ_BODY, robot.root_body)
    add("com_ang_mom_w", mjtSensor.mjSENS_SUBTREEANGMOM, mjtObj.mjOBJ_BODY, robot.root_body)
    for signal, kind in (
        ("foot_pos_w", mjtSensor.mjSENS_FRAMEPOS),
        ("foot_normal_w", mjtSensor.mjSENS_FRAMEZAXIS),
        ("foot_lin_vel_w", mjtSensor.mjSENS_FRAMELINVEL),
    ):
        for side, site in zip(SIDES, robot.foot_sites, strict=True):
            add(f"{signal}/{side}", kind, mjtObj.mjOBJ_SITE, site)


def add_contact_sensors(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Adds sensors of the net ground force on each foot, each shin and the whole robot, in the world frame, and of the
    strongest contact between two parts of the robot. The terrain geom must be in the spec."""
    for signal, bodies in (("foot_force_w", robot.foot_bodies), ("shin_force_w", robot.shin_bodies)):
        for side, body in zip(SIDES, bodies, strict=True):
            _add_ground_force(spec, f"{signal}/{side}", mjtObj.mjOBJ_BODY, body)
    _add_ground_force(spec, "robot_force_w", mjtObj.mjOBJ_XBODY, robot.root_body)
    # A net force would be of no use: what two parts do to each other cancels.
    whole = (mjtObj.mjOBJ_XBODY, robot.root_body)
    _add_contact_force(spec, "self_force", whole, whole, STRONGEST)


def _add_ground_force(spec: mujoco.MjSpec, name: str, objtype: mjtObj, body: str) -> None:
    # MuJoCo gives the force of the first object on the second, so the ground comes first.
    _add_contact_force(spec, name, (mjtObj.mjOBJ_GEOM, TERRAIN_GEOM), (objtype, body), NET)


def _add_contact_force(
    spec: mujoco.MjSpec, name: str, first: tuple[mjtObj, str], second: tuple[mjtObj, str], reduction: int
) -> None:
    """Adds a sensor of the force in contacts of two objects; an XBODY stands for the body's whole subtree."""
    # intprm: data bits, reduction, slots.
    force_bit = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE)
    spec.add_sensor(
        name=name,
        type=mjtSensor.mjSENS_CONTACT,
        objtype=first[0],
        objname=first[1],
        reftype=second[0],
        refname=second[1],
        intprm=[force_bit, reduction, 1],
    )
