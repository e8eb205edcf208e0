"""What the Unitree G1 model touches, senses and carries."""

from __future__ import annotations

import itertools

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robots.unitree_g1 import UNITREE_G1
from robots.unitree_g1.model import SITES

CROSSING_LINKS = ("knee_link", "ankle_roll_link")


def at_knees_bent(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("knees_bent").id)
    mujoco.mj_forward(model, data)
    return data


def test_every_ground_contact_but_of_feet_and_shins_is_one_of_the_upper_body(model):
    touching = {model.body(model.geom_bodyid[i]).name for i in range(model.ngeom) if model.geom_conaffinity[i]}
    upper = touching - set(UNITREE_G1.foot_bodies) - set(UNITREE_G1.shin_bodies) - {"world"}
    for part in ("pelvis", "torso", "hip", "elbow", "wrist"):
        assert any(part in body for body in upper), part
    assert set(UNITREE_G1.shin_bodies) <= touching


def test_in_the_default_pose_the_soles_just_touch_the_ground(model):
    data = at_knees_bent(model)
    bottoms = [data.geom(name).xpos[2] - model.geom(name).size[0] for foot in UNITREE_G1.foot_geoms for name in foot]
    assert min(bottoms) == pytest.approx(0.0, abs=1e-5)
    assert max(bottoms) < 0.002  # the published pose holds the feet 0.006 rad toes-up


def test_sole_sites_lie_in_the_plane_of_the_soles_with_their_normal_up(model):
    data = at_knees_bent(model)
    for site, foot, body in zip(UNITREE_G1.foot_sites, UNITREE_G1.foot_geoms, UNITREE_G1.foot_bodies, strict=True):
        assert model.body(model.site(site).bodyid[0]).name == body
        for name in foot:
            geom = model.geom(name)
            assert model.body(geom.bodyid[0]).name == body
            assert geom.pos[2] - geom.size[0] == pytest.approx(-0.035, abs=1e-12)
        assert model.site(site).pos[2] == pytest.approx(-0.035, abs=1e-12)
        assert data.site(site).xmat[8] > 0.9999


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_only_shins_and_feet_of_opposite_legs_touch_within_the_robot(model, seed):
    data = mujoco.MjData(model)
    mujoco.mj_resetData(model, data)
    data.qpos[7:] = np.random.default_rng(seed).uniform(*model.jnt_range[1:].T)
    mujoco.mj_forward(model, data)
    touching = {frozenset(pair) for pair in data.contact.geom.tolist()}
    allowed = {side: [i for i in range(model.ngeom) if crossing_side(model, i) == side] for side in ("left", "right")}
    overlapping = {
        frozenset(pair)
        for pair in itertools.product(allowed["left"], allowed["right"])
        if mujoco.mj_geomDistance(model, data, *pair, 0.1, None) < 0.0
    }
    assert touching == overlapping


def crossing_side(model: mujoco.MjModel, geom: int) -> str | None:
    side, _, link = model.body(model.geom_bodyid[geom]).name.partition("_")
    return side if model.geom(geom).name and link in CROSSING_LINKS else None


def test_crossed_feet_collide_and_a_thigh_passes_through_the_torso(model):
    data = at_knees_bent(model)
    data.joint("left_hip_roll_joint").qpos[0] = -0.15
    data.joint("right_hip_roll_joint").qpos[0] = 0.15
    mujoco.mj_forward(model, data)
    names = {frozenset(model.geom(i).name.split("_")[0] for i in pair) for pair in data.contact.geom.tolist()}
    assert names == {frozenset(("left", "right"))}

    data = at_knees_bent(model)
    data.joint("left_hip_pitch_joint").qpos[0] = -2.5
    data.joint("left_hip_roll_joint").qpos[0] = -0.5
    data.joint("waist_pitch_joint").qpos[0] = 0.52
    mujoco.mj_forward(model, data)
    thigh, torso = model.geom("left_thigh_collision").id, model.geom("torso_collision").id
    assert mujoco.mj_geomDistance(model, data, thigh, torso, 0.5, None) < 0.0
    assert data.ncon == 0


def test_every_collision_shape_meets_the_ground_and_no_drawn_shape_does(model_on_ground):
    model = model_on_ground
    data = at_knees_bent(model)
    data.qpos[2] = -3.0  # wholly under the plane
    mujoco.mj_forward(model, data)
    met = {model.geom(i).name for pair in data.contact.geom.tolist() for i in pair}
    named = {model.geom(i).name for i in range(model.ngeom) if model.geom(i).name}
    assert met == named
    bodies = {model.body(model.geom(name).bodyid[0]).name for name in named}
    assert bodies >= {
        "pelvis",
        "torso_link",
        "left_hip_yaw_link",
        "right_knee_link",
        "left_elbow_link",
        "right_wrist_yaw_link",
    }


def test_the_friction_of_the_feet_decides_whatever_the_ground_has(model_on_ground):
    model = model_on_ground
    data = at_knees_bent(model)
    data.qpos[2] -= 0.005
    mujoco.mj_forward(model, data)
    assert data.ncon == 8
    for contact in data.contact:
        assert contact.dim == 3
        assert contact.friction[0] == contact.friction[1] == 0.8  # MuJoCo's plane has 1.0


# Sensors and statics


def test_every_named_signal_has_its_sensor(model_on_ground):
    names = {model_on_ground.sensor(i).name for i in range(model_on_ground.nsensor)}
    for joint in UNITREE_G1.joint_names:
        assert {f"joint_pos/{joint}", f"joint_vel/{joint}"} <= names
    for foot_signal in ("foot_pos_w", "foot_normal_w", "foot_lin_vel_w", "foot_force_w"):
        assert {f"{foot_signal}/left", f"{foot_signal}/right"} <= names
    assert {"root_pos_w", "root_quat_w", "root_lin_vel_w", "root_ang_vel_b", "robot_force_w"} <= names
    assert {"torso_quat_w", "torso_ang_vel_w", "com_pos_w", "com_lin_vel_w", "com_ang_mom_w"} <= names
    for site in SITES:
        assert model_on_ground.site(site).id >= 0


def test_balanced_at_ankles_and_hips_the_robot_stands_still_and_the_ground_carries_its_weight(model_on_ground):
    """Two ankles' springs (57 Nm/rad) are weaker than gravity (m g h = 220 Nm/rad): a held pose topples.

    So the torques that carry the weight are fed forward, the ankles return the CoM, the hips right the trunk.
    """
    model = model_on_ground
    data = at_knees_bent(model)
    weight = UNITREE_G1.total_mass * 9.81
    hold = standing_targets(model, data)
    com = data.sensor("com_pos_w").data.copy()
    start = data.qpos.copy()
    for _ in range(1000):
        # Nm for each m and m/s of the centre of mass; tilting away it gains m g = 327 Nm a metre
        push = 500.0 * (data.sensor("com_pos_w").data - com) + 150.0 * data.sensor("com_lin_vel_w").data
        # Nm for each rad and rad/s of the pelvis' pitch
        righting = 200.0 * 2.0 * data.sensor("root_quat_w").data[2] + 20.0 * data.sensor("root_ang_vel_b").data[1]
        torque = np.zeros(model.nu)
        torque[joints("ankle_pitch")] = push[0] / 2
        torque[joints("ankle_roll")] = -push[1] / 2
        torque[joints("hip_pitch")] = righting / 2
        data.ctrl[:] = hold + torque / UNITREE_G1.stiffness
        mujoco.mj_step(model, data)
    assert np.abs(data.qpos[:3] - start[:3]).max() < 0.02
    assert np.abs(data.qpos[7:] - start[7:]).max() < 0.02
    assert np.abs(data.qvel).max() < 0.01
    feet = [data.sensor(f"foot_force_w/{side}").data for side in ("left", "right")]
    np.testing.assert_allclose(data.sensor("robot_force_w").data, [0, 0, weight], rtol=0, atol=0.01 * weight)
    np.testing.assert_allclose(sum(feet), data.sensor("robot_force_w").data, rtol=0, atol=1e-6)
    np.testing.assert_allclose(feet[0][2], feet[1][2], rtol=0.02)


def joints(part: str) -> list[int]:
    return [UNITREE_G1.joint_names.index(f"{side}_{part}_joint") for side in ("left", "right")]


def standing_targets(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Joint targets whose springs hold the pose while each foot carries half the weight, right below the CoM."""
    torque = data.qfrc_bias.copy()
    for site, body in zip(UNITREE_G1.foot_sites, UNITREE_G1.foot_bodies, strict=True):
        jacobian = np.zeros((3, model.nv))
        below_com = np.array([data.sensor("com_pos_w").data[0], *data.site(site).xpos[1:]])
        mujoco.mj_jac(model, data, jacobian, None, below_com, model.body(body).id)
        torque -= jacobian[2] * UNITREE_G1.total_mass * 9.81 / 2
    return np.array(UNITREE_G1.default_joint_pos) + torque[6:] / UNITREE_G1.stiffness
