"""A robot's description against its own model, before anything is built on both."""

import dataclasses
import re
from collections.abc import Callable

import mujoco
import pytest

from humoslope.errors import UserError
from humoslope.scene.fit import PER_JOINT, check_fit
from robots.unitree_g1 import UNITREE_G1, UNITREE_G1_SOLID

NAMES, POSE = UNITREE_G1.joint_names, UNITREE_G1.default_joint_pos


def fit(change: Callable[[mujoco.MjSpec], object] = lambda spec: None, **changes: object) -> None:
    """Checks the G1 with another description, or with another model."""
    robot = dataclasses.replace(UNITREE_G1, **changes)
    spec = robot.make_spec()
    change(spec)
    check_fit(robot, spec)


@pytest.mark.parametrize("robot", [UNITREE_G1, UNITREE_G1_SOLID])
def test_robots_fit_their_models(robot):
    check_fit(robot, robot.make_spec())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"torso_body": "torso"}, "torso_body: body 'torso' does not exist; did you mean 'torso_link'?"),
        ({"imu_site": "imu"}, "imu_site: site 'imu' does not exist; did you mean"),
        ({"shin_bodies": ("left_knee_link", "right_shin")}, "shin_bodies: body 'right_shin' does not exist;"),
        ({"foot_geoms": (UNITREE_G1.foot_geoms[0], ("sole",))}, "foot_geoms: geom 'sole' does not exist;"),
        ({"imu_site": "imu_in_torso"}, "site 'imu_in_torso' must be on 'pelvis' and parallel to its axes"),
        ({"foot_bodies": UNITREE_G1.foot_bodies[:1]}, "foot_bodies must name a left and a right one"),
        ({"foot_geoms": UNITREE_G1.foot_geoms[:1]}, "foot_geoms must name a left and a right one"),
        ({"foot_sites": UNITREE_G1.foot_sites[::-1]}, "the foot_geoms of its side must be on 'left_ankle_roll_link'"),
        ({"foot_geoms": UNITREE_G1.foot_geoms[::-1]}, "the foot_geoms of its side must be on 'left_ankle_roll_link'"),
        (
            {"stiffness": (99.0, *UNITREE_G1.stiffness[1:])},
            f"actuator '{NAMES[0]}' of its model must be a posi",
        ),
        ({"damping": (99.0, *UNITREE_G1.damping[1:])}, f"actuator '{NAMES[0]}' of its model must be a posi"),
        ({"effort_limit": (99.0, *UNITREE_G1.effort_limit[1:])}, f"actuator '{NAMES[0]}' of its model must be a posi"),
        ({"stiffness": (1.0, 2.0)}, "stiffness has 2 values for 29 joints."),
        ({"total_mass": 35.0}, "total_mass is 35 kg, but the model has 33.3411 kg."),
        ({"default_joint_pos": (3.0, *POSE[1:])}, f"default_joint_pos of '{NAMES[0]}' is 3 rad, but the joint's range"),
        ({"root_body": "torso_link"}, "its model must have a free joint on root_body, and hinges beyond it."),
    ],
)
def test_what_does_not_fit_is_named(changes, message):
    with pytest.raises(UserError, match=f"robot {UNITREE_G1.name}: .*{re.escape(message)}"):
        fit(**changes)


def test_joints_in_another_order_than_the_models_are_refused():
    # States and controls are read and written by their order: such a robot would move the wrong joints.
    swapped = (NAMES[1], NAMES[0], *NAMES[2:])
    with pytest.raises(UserError, match=f"in the order of its model, where joint 0 is '{NAMES[0]}', not '{NAMES[1]}'"):
        fit(joint_names=swapped)


def test_actuators_in_another_order_than_the_models_are_refused():
    def swap(spec: mujoco.MjSpec) -> None:
        first, second = spec.actuators[:2]
        first.name, second.name = "aside", first.name
        first.name = NAMES[1]

    with pytest.raises(UserError, match=f"where actuator 0 is '{NAMES[1]}', not '{NAMES[0]}'"):
        fit(swap)


def test_an_actuator_that_drives_another_joint_is_refused():
    def cross(spec: mujoco.MjSpec) -> None:
        first, second = spec.actuators[:2]
        first.target, second.target = second.target, first.target

    with pytest.raises(UserError, match=f"actuator '{NAMES[0]}' of its model must be a position control of the joint"):
        fit(cross)


def test_a_joint_without_a_range_is_refused():
    # Resets keep joints within their range, which MuJoCo gives as 0 to 0 where there is none.
    def free(spec: mujoco.MjSpec) -> None:
        spec.joint(NAMES[4]).limited = mujoco.mjtLimited.mjLIMITED_FALSE

    with pytest.raises(UserError, match=f"joint '{NAMES[4]}' of its model has no range"):
        fit(free)


def test_a_description_with_fewer_joints_than_the_model_is_refused():
    shorter = {name: getattr(UNITREE_G1, name)[:-1] for name in ("joint_names", *PER_JOINT)}
    with pytest.raises(UserError, match="joint_names has 28 names, but its model has 29 joints"):
        fit(**shorter)


def test_a_model_with_a_sliding_joint_is_refused():
    def slide(spec: mujoco.MjSpec) -> None:
        spec.joint(NAMES[0]).type = mujoco.mjtJoint.mjJNT_SLIDE

    with pytest.raises(UserError, match="hinges beyond it"):
        fit(slide)
