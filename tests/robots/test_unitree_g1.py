"""The Unitree G1 model against the published figures (tests/data/unitree_g1.json) and another reader of its URDF."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yourdfpy
from hypothesis import given, settings
from hypothesis import strategies as st

from robots.unitree_g1 import UNITREE_G1
from robots.unitree_g1.model import URDF

PUBLISHED: dict[str, Any] = json.loads((Path(__file__).parents[1] / "data" / "unitree_g1.json").read_text())
BODIES = {body["name"]: body for body in PUBLISHED["bodies"]}
JOINTS = {body["joint"]["name"]: body["joint"] for body in PUBLISHED["bodies"] if "joint" in body}

# fmt: off
SDK_ORDER = [
    "left_hip_pitch", "left_hip_roll", "left_hip_yaw", "left_knee", "left_ankle_pitch", "left_ankle_roll",
    "right_hip_pitch", "right_hip_roll", "right_hip_yaw", "right_knee", "right_ankle_pitch", "right_ankle_roll",
    "waist_yaw", "waist_roll", "waist_pitch",
    "left_shoulder_pitch", "left_shoulder_roll", "left_shoulder_yaw", "left_elbow",
    "left_wrist_roll", "left_wrist_pitch", "left_wrist_yaw",
    "right_shoulder_pitch", "right_shoulder_roll", "right_shoulder_yaw", "right_elbow",
    "right_wrist_roll", "right_wrist_pitch", "right_wrist_yaw",
]
# fmt: on

PAIRED_LINKS = [name.removeprefix("left_") for name in BODIES if name.startswith("left_")]


@pytest.fixture(scope="module")
def urdf() -> yourdfpy.URDF:
    return yourdfpy.URDF.load(str(URDF), load_meshes=False)


def rotation(quat_wxyz: Any) -> np.ndarray:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quat_wxyz, dtype=float) / np.linalg.norm(quat_wxyz))
    return matrix.reshape(3, 3)


def inertia(quat_wxyz: Any, principal: Any) -> np.ndarray:
    axes = rotation(quat_wxyz)
    return axes @ np.diag(principal) @ axes.T


def body_inertia(model: mujoco.MjModel, name: str) -> np.ndarray:
    body = model.body(name)
    return inertia(body.iquat, body.inertia)


# The published figures


def test_joints_and_actuators_follow_the_order_of_unitrees_sdk(model):
    expected = [f"{name}_joint" for name in SDK_ORDER]
    assert list(UNITREE_G1.joint_names) == expected
    assert [model.joint(i + 1).name for i in range(model.njnt - 1)] == expected
    assert [model.actuator(i).name for i in range(model.nu)] == expected
    assert model.actuator_trnid[:, 0].tolist() == list(range(1, 30))


def test_the_robot_weighs_what_unitree_says(model):
    assert model.body_mass.sum() == pytest.approx(33.341, abs=0.002)
    assert model.body_mass.sum() == pytest.approx(UNITREE_G1.total_mass, abs=1e-9)


@pytest.mark.parametrize("name", BODIES)
def test_every_link_has_its_published_frame_mass_and_inertia(model, name):
    published, body = BODIES[name], model.body(name)
    assert body.mass[0] == pytest.approx(published["mass"], rel=1e-12)
    np.testing.assert_allclose(body.ipos, published["com"], rtol=1e-12, atol=0)
    expected = inertia(published["inertia_quat_wxyz"], published["inertia_diag"])
    np.testing.assert_allclose(body_inertia(model, name), expected, rtol=0, atol=1e-12 * np.linalg.norm(expected))
    if published["parent"] != "world":
        assert model.body(body.parentid[0]).name == published["parent"]
        np.testing.assert_allclose(body.pos, published["pos"], rtol=1e-12, atol=0)
        np.testing.assert_allclose(rotation(body.quat), rotation(published["quat_wxyz"]), rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", JOINTS)
def test_every_joint_has_its_published_axis_range_armature_and_effort(model, name):
    published, joint = JOINTS[name], model.joint(name)
    np.testing.assert_allclose(joint.axis, published["axis"])
    np.testing.assert_allclose(joint.range, published["range"], rtol=1e-12)
    assert joint.armature[0] == pytest.approx(published["armature"], rel=1e-9)
    effort = published["effort_limit"]
    np.testing.assert_allclose(model.actuator(name).forcerange, [-effort, effort])
    assert UNITREE_G1.effort_limit[UNITREE_G1.joint_names.index(name)] == effort


def test_the_urdf_carries_the_published_effort_and_velocity_limits():
    limits = {joint.attrib["name"]: joint.find("limit") for joint in ET.parse(URDF).getroot().iter("joint")}
    assert set(limits) == set(JOINTS)
    for name, limit in limits.items():
        assert limit is not None
        assert float(limit.attrib["effort"]) == JOINTS[name]["effort_limit"]
        assert float(limit.attrib["velocity"]) == JOINTS[name]["velocity_limit"]


def test_gains_give_every_drive_ten_hertz_and_a_damping_ratio_of_two(model):
    frequency = 2 * math.pi * 10
    for i, name in enumerate(UNITREE_G1.joint_names):
        stiffness = JOINTS[name]["armature"] * frequency**2
        damping = 2 * 2 * JOINTS[name]["armature"] * frequency
        actuator = model.actuator(name)
        assert UNITREE_G1.stiffness[i] == actuator.gainprm[0] == -actuator.biasprm[1] == pytest.approx(stiffness)
        assert UNITREE_G1.damping[i] == -actuator.biasprm[2] == pytest.approx(damping)
        assert UNITREE_G1.action_scale[i] == pytest.approx(0.25 * JOINTS[name]["effort_limit"] / stiffness)


def test_the_default_pose_is_the_published_one_with_bent_knees(model):
    pose = PUBLISHED["poses"]["knees_bent"]["joints"]
    expected = [pose.get(name, pose.get(name.split("_", 1)[-1], 0.0)) for name in SDK_ORDER]
    assert list(UNITREE_G1.default_joint_pos) == expected
    np.testing.assert_array_equal(model.key("knees_bent").qpos[7:], expected)
    np.testing.assert_array_equal(model.key("knees_bent").ctrl, expected)


# Kinematics


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_every_link_is_where_an_independent_urdf_reader_puts_it(model, urdf, seed):
    data = mujoco.MjData(model)
    data.qpos[7:] = np.random.default_rng(seed).uniform(*model.jnt_range[1:].T)
    data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
    mujoco.mj_kinematics(model, data)
    urdf.update_cfg(dict(zip(UNITREE_G1.joint_names, data.qpos[7:], strict=True)))
    for name in BODIES:
        transform = urdf.get_transform(name, "pelvis")
        np.testing.assert_allclose(data.body(name).xpos, transform[:3, 3], rtol=0, atol=1e-12)
        np.testing.assert_allclose(data.body(name).xmat.reshape(3, 3), transform[:3, :3], rtol=0, atol=1e-12)


def test_the_right_side_mirrors_the_left(model):
    # The published sides are not exact mirrors: one shoulder sits 0.01 mm further out, and the right shin's ixz has the
    # left one's magnitude with the sign that a mirror would not give it, which is 0.56 % of the tensor's norm.
    mirror = np.diag([1.0, -1.0, 1.0])
    for link in PAIRED_LINKS:
        left, right = model.body(f"left_{link}"), model.body(f"right_{link}")
        assert left.mass[0] == right.mass[0]
        np.testing.assert_allclose(left.ipos, mirror @ right.ipos, rtol=0, atol=1e-12)
        np.testing.assert_allclose(left.pos, mirror @ right.pos, rtol=0, atol=1.1e-5)
        np.testing.assert_allclose(rotation(left.quat), mirror @ rotation(right.quat) @ mirror, rtol=0, atol=1e-12)
        left_inertia, right_inertia = body_inertia(model, left.name), body_inertia(model, right.name)
        scale = np.linalg.norm(left_inertia)
        np.testing.assert_allclose(left_inertia, mirror @ right_inertia @ mirror, rtol=0, atol=0.006 * scale)
    for name in UNITREE_G1.joint_names:
        if name.startswith("left_"):
            left, right = model.joint(name), model.joint(name.replace("left", "right"))
            sideways = left.axis[1] == 0.0  # roll and yaw change sign in the mirror, pitch does not
            np.testing.assert_allclose(left.range, -right.range[::-1] if sideways else right.range, rtol=0, atol=1e-12)
            drive, other = model.actuator(name), model.actuator(right.name)
            np.testing.assert_array_equal(drive.gainprm, other.gainprm)
            np.testing.assert_array_equal(drive.biasprm, other.biasprm)
            np.testing.assert_array_equal(drive.forcerange, other.forcerange)


def test_collision_shapes_of_the_right_side_mirror_those_of_the_left(model):
    # The four corners of a sole may swap names, so all are sorted.
    def corners(side: str, sign: float) -> np.ndarray:
        names = [model.geom(i).name for i in range(model.ngeom) if model.geom(i).name.startswith(side)]
        rows = [(*(model.geom(name).pos * [1, sign, 1]), *model.geom(name).size[:2]) for name in names]
        return np.array(sorted(np.round(rows, 9).tolist()))

    np.testing.assert_allclose(corners("left", 1.0), corners("right", -1.0), rtol=0, atol=1e-8)
