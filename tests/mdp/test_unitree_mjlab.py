"""The terms of Unitree's MuJoCo task, on hand-made states and against plain MuJoCo."""

from __future__ import annotations

import math
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from humoslope.errors import UserError
from humoslope.mdp import unitree_mjlab as mjlab
from robots.unitree_g1 import UNITREE_G1
from tasks.unitree_mjlab import RUNNING, STANDING, WALKING

JOINTS = UNITREE_G1.joint_names
angles = st.floats(-40.0, 40.0)
speeds = st.floats(-1.0, 1.0)


def command(*velocity):
    return SimpleNamespace(velocity=torch.tensor([velocity]))


WALK, STAND = command(0.5, 0.0, 0.0), command(0.06, 0.0, -0.04)
"""A command to walk, and one that is just small enough to be one to stand."""


# Velocity


@given(heading=st.floats(-180.0, 180.0), pitch=angles, roll=angles, forward=speeds, left=speeds, up=speeds)
def test_velocity_is_tracked_along_the_axes_of_the_leaning_root_and_none_is_wanted_upward(
    make_env, pose, heading, pitch, roll, forward, left, up
):
    turned = Rotation.from_euler("ZYX", [heading, pitch, roll], degrees=True)
    velocity = turned.apply([forward + 0.3, left - 0.4, up])
    signals = pose(root_quat_w=turned.as_quat(scalar_first=True), root_lin_vel_w=velocity).signals
    env = make_env(1, signals=signals, commands=command(forward, left, 0.0))
    expected = math.exp(-(0.25 + 2.0 * up**2) / 0.25)
    assert mjlab.track_body_velocity_exp(env, std=0.5).item() == pytest.approx(expected, abs=1e-5)


def test_an_upright_robot_that_climbs_30_degrees_as_commanded_loses_two_fifths_of_this_reward(make_env, pose):
    along = [0.5 * math.cos(math.radians(30.0)), 0.0, 0.5 * math.sin(math.radians(30.0))]
    env = make_env(1, signals=pose(30.0, root_lin_vel_w=along).signals, commands=WALK)
    missing = 0.5 - along[0]
    expected = math.exp(-(missing**2 + 2.0 * along[2] ** 2) / 0.25)
    assert mjlab.track_body_velocity_exp(env, std=0.5).item() == pytest.approx(expected, abs=1e-5)
    assert expected == pytest.approx(0.60, abs=0.01)


@given(roll=speeds, pitch=speeds, error=speeds)
def test_turning_is_about_the_roots_own_axis_and_other_rates_count_a_twentieth(make_env, pose, roll, pitch, error):
    signals = pose(root_ang_vel_b=[roll, pitch, 0.4 + error]).signals
    env = make_env(1, signals=signals, commands=command(0.0, 0.0, 0.4))
    expected = math.exp(-(error**2 + 0.05 * (roll**2 + pitch**2)) / 0.25)
    assert mjlab.track_body_turning_exp(env, std=0.5).item() == pytest.approx(expected, abs=1e-5)


def test_the_size_of_a_command_is_its_speed_plus_its_turning(make_env):
    assert mjlab.size_of_command(make_env(1, commands=command(0.3, -0.4, -0.2))).item() == pytest.approx(0.7)


# Posture


def posture(make_env, velocity=(0.5, 0.0, 0.0), off=None, **changes):
    """The posture's reward with joints `off` rad from the default pose by name."""
    pos = torch.zeros(1, len(JOINTS))
    for name, angle in (off or {}).items():
        pos[0, JOINTS.index(name)] = angle
    env = make_env(
        1,
        robot=UNITREE_G1,
        signals=SimpleNamespace(joint_pos=pos + 0.2),
        default_joint_pos=torch.full((len(JOINTS),), 0.2),
        commands=command(*velocity),
    )
    term = mjlab.PostureExp(env, **({"standing": STANDING, "walking": WALKING, "running": RUNNING} | changes))
    return term(env).item()


@pytest.mark.parametrize(
    ("velocity", "knee", "waist"),
    [
        ((0.0, 0.0, 0.0), 0.05, 0.05),
        ((0.06, 0.0, -0.03), 0.05, 0.05),
        ((0.06, 0.0, -0.05), 0.5, 0.15),  # from 0.1 on one walks
        ((0.9, 0.0, 0.5), 0.5, 0.15),
        ((1.2, 0.0, 0.31), 0.5, 0.25),  # from 1.5 on one runs
    ],
)
def test_the_tolerance_of_each_joint_follows_the_command(make_env, velocity, knee, waist):
    off = {"left_knee_joint": 0.1, "waist_yaw_joint": -0.2}
    expected = math.exp(-((0.1 / knee) ** 2 + (0.2 / waist) ** 2) / 29)
    assert posture(make_env, velocity, off) == pytest.approx(expected, abs=1e-6)


def test_the_default_pose_earns_all(make_env):
    assert posture(make_env) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"walking": {"hip": 0.1}}, "walking: joint 'left_knee_joint' needs one tolerance; it has none"),
        ({"running": RUNNING | {"hip": 0.1}}, "running: joint 'left_hip_pitch_joint' .* those of hip_pitch and hip"),
        ({"walking": WALKING | {"neck": 0.1}}, "walking: 'neck' occurs in no joint's name; there are left_hip_pitch"),
    ],
)
def test_a_joint_without_a_tolerance_or_with_two_is_refused(make_env, changes, said):
    with pytest.raises(UserError, match=said):
        posture(make_env, **changes)


# Momentum


def test_rates_of_the_torso_count_about_the_worlds_horizontal_axes(make_env, pose):
    signals = pose(torso_quat_w=[0.6, 0.8, 0.0, 0.0], torso_ang_vel_w=[0.3, -0.4, 9.0]).signals
    assert mjlab.torso_ang_vel_xy_l2(make_env(1, signals=signals)).item() == pytest.approx(0.25)


def test_the_angular_momentum_is_that_of_all_bodies_about_their_centre_of_mass(make_env, pose, g1):
    random = np.random.default_rng(0)
    data = mujoco.MjData(g1)
    data.qpos[:] = [0.3, -0.2, 1.5, 0.6, 0.0, 0.8, 0.0, *random.uniform(-0.3, 0.3, g1.nu)]
    data.qvel[:] = random.normal(size=g1.nv)
    mujoco.mj_forward(g1, data)
    mass, spin, velocity = g1.body_mass[:, None], np.zeros((g1.nbody, 3)), np.zeros((g1.nbody, 3))
    for body in range(g1.nbody):
        both = np.zeros(6)
        mujoco.mj_objectVelocity(g1, data, mujoco.mjtObj.mjOBJ_BODY, body, both, 0)  # of the inertial frame, world axes
        axes = data.ximat[body].reshape(3, 3)
        spin[body], velocity[body] = axes @ np.diag(g1.body_inertia[body]) @ axes.T @ both[:3], both[3:]
    centre, drift = (mass * data.xipos).sum(0) / mass.sum(), (mass * velocity).sum(0) / mass.sum()
    expected = (np.cross(data.xipos - centre, mass * (velocity - drift)) + spin).sum(axis=0)

    measured = data.sensor("com_ang_mom_w").data
    assert np.linalg.norm(expected) > 1.0
    assert measured == pytest.approx(expected, abs=1e-9)
    env = make_env(1, signals=pose(com_ang_mom_w=measured).signals)
    assert mjlab.angular_momentum_l2(env).item() == pytest.approx(expected @ expected, rel=1e-5)


# Steps

BOTH, LEFT, RIGHT, NONE = [True, True], [True, False], [False, True], [False, False]


def stepping(make_env, commands=WALK, **signals):
    signals = {"foot_contact": torch.tensor([BOTH]), **signals}
    return make_env(1, signals=SimpleNamespace(**signals), commands=commands)


def walk(env, term, *contacts):
    earned = []
    for contact in contacts:
        env.signals.foot_contact = torch.tensor([contact])
        earned.append(term(env).item())
    return earned


def test_time_on_one_leg_earns_most_at_the_target_and_nothing_at_twice_that(make_env):
    env = stepping(make_env)
    term = mjlab.StepTime(env, target=0.06)
    earned = walk(env, term, BOTH, *[LEFT] * 7, BOTH, RIGHT, NONE, RIGHT)
    up_and_down = [0.02, 0.04, 0.06, 0.04, 0.02, 0.0, 0.0]
    assert earned == pytest.approx([0.0, *up_and_down, 0.0, 0.02, 0.0, 0.02], abs=1e-6)
    assert walk(env, term, RIGHT) == pytest.approx([0.04], abs=1e-6)
    term.reset(torch.tensor([True]))
    assert walk(env, term, RIGHT) == pytest.approx([0.02], abs=1e-6)


def test_who_shall_stand_is_paid_for_no_step_and_pays_for_none(make_env):
    moving = {
        "foot_lin_vel_w": torch.ones(1, 2, 3),
        "foot_height": torch.zeros(1, 2),
        "foot_force": torch.full((1, 2), 300.0),
    }
    for commands, counts in ((STAND, False), (WALK, True), (command(0.0, 0.0, 0.2), True)):
        env = stepping(make_env, commands, **moving)
        assert (mjlab.foot_clearance_l1(env, target=0.1).item() > 0.0) == counts
        assert (mjlab.slip_l2(env).item() > 0.0) == counts
        assert (walk(env, mjlab.StepTime(env, target=0.3), LEFT)[0] > 0.0) == counts
        assert (walk(env, mjlab.LandingForce(env), LEFT, BOTH)[1] > 0.0) == counts


def test_a_moving_foot_pays_for_its_distance_from_a_height_over_the_ground(make_env, pose):
    ground = math.tan(math.radians(20.0))
    posed = pose(
        20.0,
        foot_pos_w={"left": [1.0, 0.1, ground + 0.04], "right": [0.0, -0.1, 0.13]},
        foot_lin_vel_w={"left": [0.3, 0.4, 7.0], "right": [0.0, 2.0, 0.0]},
    )
    env = make_env(1, signals=posed.signals, commands=WALK)
    assert mjlab.foot_clearance_l1(env, target=0.1).item() == pytest.approx(0.06 * 0.5 + 0.03 * 2.0, abs=1e-5)


def test_a_foot_on_the_ground_pays_for_its_squared_horizontal_speed(make_env, pose):
    posed = pose(
        foot_lin_vel_w={"left": [0.3, 0.4, 7.0], "right": [5.0, 0.0, 0.0]}, foot_force_w={"left": [0.0, 0.0, 200.0]}
    )
    assert mjlab.slip_l2(make_env(1, signals=posed.signals, commands=WALK)).item() == pytest.approx(0.25)


def test_a_landing_costs_the_force_of_its_first_step_alone(make_env):
    env = stepping(make_env, foot_force=torch.tensor([[300.0, 500.0]]))
    term = mjlab.LandingForce(env)
    assert walk(env, term, BOTH, BOTH, LEFT, BOTH, BOTH, NONE, BOTH) == [0.0, 0.0, 0.0, 500.0, 0.0, 0.0, 800.0]
    walk(env, term, NONE)
    term.reset(torch.tensor([True]))
    assert walk(env, term, BOTH) == [0.0]
