"""A robot with the gains and the default pose of somebody else's policy."""

from __future__ import annotations

import dataclasses

import mujoco

from humoslope.scene.robot import Robot


def redriven(
    robot: Robot,
    default: tuple[float, ...],
    action_scale: tuple[float, ...],
    stiffness: tuple[float, ...],
    damping: tuple[float, ...],
) -> Robot:
    """Returns a robot with another default pose, in which its feet are as high as before, and other gains.

    Args:
        robot: The robot.
        default: Joint positions of a zero action, rad, like all in the order of its joints.
        action_scale: Change of the joint target per unit of action, rad.
        stiffness: Position gains, Nm/rad.
        damping: Velocity gains, Nm s/rad.
    """

    def make_spec() -> mujoco.MjSpec:
        spec = robot.make_spec()
        for name, kp, kd in zip(robot.joint_names, stiffness, damping, strict=True):
            drive = spec.actuator(name)
            drive.gainprm[0], drive.biasprm[1], drive.biasprm[2] = kp, -kp, -kd
        for key in spec.keys:
            spec.delete(key)  # of the other pose
        return spec

    height = robot.default_root_height
    if default != robot.default_joint_pos:
        model = robot.make_spec().compile()
        height += _lowest_foot(robot, model, robot.default_joint_pos) - _lowest_foot(robot, model, default)
    return dataclasses.replace(
        robot,
        make_spec=make_spec,
        default_joint_pos=default,
        default_root_height=height,
        action_scale=action_scale,
        stiffness=stiffness,
        damping=damping,
    )


def _lowest_foot(robot: Robot, model: mujoco.MjModel, pose: tuple[float, ...]) -> float:
    """Height of the lower sole above the root's origin when the root is upright, m."""
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    for name, angle in zip(robot.joint_names, pose, strict=True):
        data.qpos[model.joint(name).qposadr[0]] = angle
    mujoco.mj_kinematics(model, data)
    root = data.body(robot.root_body).xpos[2]
    return float(min(data.site(site).xpos[2] for site in robot.foot_sites) - root)
