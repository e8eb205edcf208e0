"""Whether the description of a robot fits its model: what would go wrong in silence, or deep inside of MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco import mjtObj

from humoslope.errors import UserError, unknown
from humoslope.scene.robot import Robot
from humoslope.scene.sensors import SIDES

PER_JOINT = ("default_joint_pos", "action_scale", "stiffness", "damping", "effort_limit")
"""Fields of `Robot` with one value per joint."""
PAIRS = ("foot_bodies", "shin_bodies", "foot_sites", "foot_geoms")
"""Fields of `Robot` with something for each side."""
ROUNDING = 1e-3
"""Largest difference of the stated mass from the model's, as a share of it: a data sheet gives grams."""


def check_fit(robot: Robot, spec: mujoco.MjSpec) -> None:
    """Checks that a robot fits the model that its `make_spec` makes, before anything is added to that.

    Raises:
        UserError: If a named part does not exist or is in a wrong place, joints or actuators are others than
            `joint_names` or in another order, a value per joint is missing or a default position out of range, or gains
            or mass are not the model's.
    """
    for name in PAIRS:
        if len(getattr(robot, name)) != len(SIDES):
            raise UserError(f"robot {robot.name}: {name} must name a left and a right one, in this order.")
    for name in PER_JOINT:
        if len(getattr(robot, name)) != robot.num_joints:
            raise UserError(
                f"robot {robot.name}: {name} has {len(getattr(robot, name))} values for {robot.num_joints} joints."
            )
    model = spec.compile()
    for field, kind, names in _named(robot):
        for name in names:
            if mujoco.mj_name2id(model, kind, name) < 0:
                raise UserError(f"robot {robot.name}: {field}: {unknown(_word(kind), name, _names(model, kind))}")
    _check_joints(robot, model)
    _check_drives(robot, model)
    _check_places(robot, model)
    mass = float(model.body_mass.sum())
    if abs(mass - robot.total_mass) > ROUNDING * mass:
        raise UserError(f"robot {robot.name}: total_mass is {robot.total_mass:g} kg, but the model has {mass:.6g} kg.")


def _named(robot: Robot) -> list[tuple[str, mjtObj, tuple[str, ...]]]:
    """Field, kind and names of the parts that a robot names."""
    return [
        ("root_body", mjtObj.mjOBJ_BODY, (robot.root_body,)),
        ("torso_body", mjtObj.mjOBJ_BODY, (robot.torso_body,)),
        ("imu_site", mjtObj.mjOBJ_SITE, (robot.imu_site,)),
        ("foot_bodies", mjtObj.mjOBJ_BODY, robot.foot_bodies),
        ("shin_bodies", mjtObj.mjOBJ_BODY, robot.shin_bodies),
        ("foot_sites", mjtObj.mjOBJ_SITE, robot.foot_sites),
        ("foot_geoms", mjtObj.mjOBJ_GEOM, (*robot.foot_geoms[0], *robot.foot_geoms[1])),
    ]


def _check_joints(robot: Robot, model: mujoco.MjModel) -> None:
    """Checks joints and actuators: states and controls are read and written by their order."""
    free, hinge = mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_HINGE
    kinds = list(model.jnt_type)
    if kinds != [free] + [hinge] * (len(kinds) - 1) or model.body(model.jnt_bodyid[0]).name != robot.root_body:
        raise UserError(f"robot {robot.name}: its model must have a free joint on root_body, and hinges beyond it.")
    for kind, names in (
        ("joint", _names(model, mjtObj.mjOBJ_JOINT)[1:]),
        ("actuator", _names(model, mjtObj.mjOBJ_ACTUATOR)),
    ):
        if len(names) != robot.num_joints:
            raise UserError(
                f"robot {robot.name}: joint_names has {robot.num_joints} names, but its model has {len(names)} {kind}s."
            )
        for i, (wanted, found) in enumerate(zip(robot.joint_names, names, strict=True)):
            if wanted != found:
                raise UserError(
                    f"robot {robot.name}: joint_names must be in the order of its model, where {kind} {i} is "
                    f"'{found}', not '{wanted}'."
                )
    for i, name in enumerate(robot.joint_names):
        (low, high), pos = model.jnt_range[1 + i], robot.default_joint_pos[i]
        if not model.jnt_limited[1 + i]:
            raise UserError(f"robot {robot.name}: joint '{name}' of its model has no range.")
        if not low <= pos <= high:
            raise UserError(
                f"robot {robot.name}: default_joint_pos of '{name}' is {pos:g} rad, but the joint's range is "
                f"{low:.4g} to {high:.4g} rad."
            )


def _check_drives(robot: Robot, model: mujoco.MjModel) -> None:
    """Checks that the model's position actuators are those that the description gives to events and to exports."""
    for i, name in enumerate(robot.joint_names):
        kp, kd, effort = robot.stiffness[i], robot.damping[i], robot.effort_limit[i]
        found = [model.actuator_gainprm[i, 0], *model.actuator_biasprm[i, :3], *model.actuator_forcerange[i]]
        if model.actuator_trnid[i, 0] != 1 + i or not np.allclose(found, [kp, 0.0, -kp, -kd, -effort, effort], 1e-4):
            raise UserError(
                f"robot {robot.name}: actuator '{name}' of its model must be a position control of the joint of this "
                f"name with stiffness {kp:.5g}, damping {kd:.5g} and torques of up to {effort:.5g} Nm."
            )


def _check_places(robot: Robot, model: mujoco.MjModel) -> None:
    """Checks on which bodies the sites and the geoms of the feet are, and the axes of the IMU's site."""
    for body, site, geoms in zip(robot.foot_bodies, robot.foot_sites, robot.foot_geoms, strict=True):
        owners = [model.site(site).bodyid[0], *(model.geom(geom).bodyid[0] for geom in geoms)]
        if any(owner != model.body(body).id for owner in owners):
            raise UserError(f"robot {robot.name}: site '{site}' and the foot_geoms of its side must be on '{body}'.")
    imu, root = model.site(robot.imu_site), model.body(robot.root_body)
    if imu.bodyid[0] != root.id or not np.allclose(imu.quat, (1.0, 0.0, 0.0, 0.0), atol=1e-6):
        raise UserError(
            f"robot {robot.name}: site '{imu.name}' must be on '{root.name}' and parallel to its axes: the angular "
            "velocity there is taken for that in the root's frame."
        )


def _names(model: mujoco.MjModel, kind: mjtObj) -> list[str]:
    counts = {
        mjtObj.mjOBJ_BODY: model.nbody,
        mjtObj.mjOBJ_SITE: model.nsite,
        mjtObj.mjOBJ_GEOM: model.ngeom,
        mjtObj.mjOBJ_JOINT: model.njnt,
        mjtObj.mjOBJ_ACTUATOR: model.nu,
    }
    return [mujoco.mj_id2name(model, kind, i) or "" for i in range(counts[kind])]


def _word(kind: mjtObj) -> str:
    return str(kind.name).removeprefix("mjOBJ_").lower()
