"""Unitree RL Lab's terms, on hand-made states."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from humoslope.mdp import unitree_rl_lab as url

angles = st.floats(-40.0, 40.0)
headings = st.floats(-180.0, 180.0)
speeds = st.floats(-1.0, 1.0)


def quat(euler, angles):
    return Rotation.from_euler(euler, angles, degrees=True).as_quat(scalar_first=True)


def command(*velocity):
    return SimpleNamespace(velocity=torch.tensor([velocity]))


# Velocity


@given(heading=headings, pitch=angles, roll=angles, forward=speeds, left=speeds, up=speeds)
def test_velocity_is_tracked_in_the_horizontal_plane_however_the_pelvis_leans(
    make_env, pose, heading, pitch, roll, forward, left, up
):
    velocity = Rotation.from_euler("z", heading, degrees=True).apply([forward, left, up])
    signals = pose(root_quat_w=quat("ZYX", [heading, pitch, roll]), root_lin_vel_w=velocity).signals
    env = make_env(1, signals=signals, commands=command(forward, left, 0.0))
    assert url.track_horizontal_velocity_exp(env, std=0.5).item() == pytest.approx(1.0, abs=1e-5)
    env.commands = command(forward + 0.3, left - 0.4, 0.0)
    assert url.track_horizontal_velocity_exp(env, std=0.5).item() == pytest.approx(math.exp(-1.0), abs=1e-5)


def test_climbing_at_the_commanded_speed_along_the_slope_is_too_slow_in_the_plane(make_env, pose):
    along = [0.5 * math.cos(math.radians(30.0)), 0.0, 0.5 * math.sin(math.radians(30.0))]
    env = make_env(1, signals=pose(30.0, root_lin_vel_w=along).signals, commands=command(0.5, 0.0, 0.0))
    expected = math.exp(-((0.5 - 0.5 * math.cos(math.radians(30.0))) ** 2) / 0.25)
    assert url.track_horizontal_velocity_exp(env, std=0.5).item() == pytest.approx(expected, abs=1e-5)
    assert url.lin_vel_z_l2(env).item() == pytest.approx(0.0625, abs=1e-5)


def test_speed_up_is_taken_along_the_pelvis_own_axis(make_env, pose):
    env = make_env(1, signals=pose(root_quat_w=quat("y", 30.0), root_lin_vel_w=[1.0, 0.0, 0.0]).signals)
    assert url.lin_vel_z_l2(env).item() == pytest.approx(0.25, abs=1e-5)


def test_turning_is_taken_about_the_pelvis_own_axis(make_env, pose):
    signals = pose(root_quat_w=quat("y", 30.0), root_ang_vel_b=[9.0, 9.0, 0.1]).signals
    env = make_env(1, signals=signals, commands=command(0.0, 0.0, 0.6))
    assert url.track_body_yaw_rate_exp(env, std=0.5).item() == pytest.approx(math.exp(-1.0), abs=1e-5)


# Posture


@given(heading=headings, lean=st.floats(0.0, 40.0), towards=headings)
def test_lean_costs_its_squared_sine_in_every_direction(make_env, pose, heading, lean, towards):
    axis = [math.cos(math.radians(towards)), math.sin(math.radians(towards)), 0.0]
    turned = Rotation.from_rotvec(math.radians(lean) * torch.tensor(axis).numpy()) * Rotation.from_euler(
        "z", heading, degrees=True
    )
    env = make_env(1, signals=pose(root_quat_w=turned.as_quat(scalar_first=True)).signals)
    assert url.flat_orientation_l2(env).item() == pytest.approx(math.sin(math.radians(lean)) ** 2, abs=1e-5)


def test_height_is_the_worlds_whatever_the_ground(make_env, pose):
    ground = 2.0 * math.tan(math.radians(25.0))
    env = make_env(1, signals=pose(25.0, root_pos_w=[2.0, 0.0, ground + 0.78]).signals)
    assert url.base_height_world_l2(env, target=0.78).item() == pytest.approx(ground**2, abs=1e-5)
    assert not url.root_too_low_in_world(env, height=0.2).item()
    env.signals = pose(25.0, root_pos_w=[-2.0, 0.0, 0.78 - ground]).signals
    assert url.root_too_low_in_world(env, height=0.2).item()


def test_joint_velocities_cost_their_squares(make_env):
    env = make_env(1, signals=SimpleNamespace(joint_vel=torch.tensor([[1.0, -2.0, 3.0]])))
    assert url.joint_vel_l2(env).item() == 14.0


# Feet

NONE, LEFT, RIGHT, BOTH = (False, False), (True, False), (False, True), (True, True)
"""Feet on the ground."""


@pytest.mark.parametrize(
    ("seconds", "contact", "right_feet"),
    [
        (0.0, LEFT, 1.0),  # both are expected: the second half begins at phase 0.5, and stance lasts to 0.55
        (0.0, BOTH, 2.0),
        (0.1, LEFT, 2.0),
        (0.1, BOTH, 1.0),
        (0.1, RIGHT, 0.0),
        (0.38, LEFT, 2.0),
        (0.42, BOTH, 2.0),  # phase 0.525
        (0.5, RIGHT, 2.0),
        (0.5, NONE, 1.0),
        (0.82, BOTH, 2.0),  # the next period
        (16.1, LEFT, 2.0),
    ],
)
def test_feet_earn_by_a_clock_that_starts_with_the_episode(make_env, seconds, contact, right_feet):
    env = make_env(
        1,
        episode_length_buf=torch.tensor([round(seconds / 0.02)]),
        signals=SimpleNamespace(foot_contact=torch.tensor([contact])),
        commands=command(0.5, 0.0, 0.0),
    )
    assert url.gait_clock(env, period=0.8, stance_share=0.55, least_command=0.1).item() == right_feet


def test_the_clock_stands_still_for_who_is_asked_for_next_to_nothing(make_env):
    env = make_env(1, episode_length_buf=torch.tensor([5]), signals=SimpleNamespace(foot_contact=torch.tensor([LEFT])))
    for velocity, earned in (((0.0, 0.0, 0.0), 0.0), ((0.06, 0.06, 0.05), 0.0), ((0.06, 0.06, 0.06), 2.0)):
        env.commands = command(*velocity)
        assert url.gait_clock(env, period=0.8, stance_share=0.55, least_command=0.1).item() == earned


def test_only_feet_on_the_ground_slide_and_only_sideways(make_env, pose):
    posed = pose(
        foot_lin_vel_w={"left": [0.3, 0.4, 7.0], "right": [5.0, 0.0, 0.0]}, foot_force_w={"left": [0.0, 0.0, 200.0]}
    )
    assert url.foot_slide_horizontal(make_env(1, signals=posed.signals)).item() == pytest.approx(0.5)


def test_a_moving_foot_scores_best_at_one_height_in_the_world(make_env, pose):
    def score(height, speed=1.0):
        posed = pose(
            20.0,
            foot_pos_w={"left": [1.0, 0.1, height], "right": [0.0, -0.1, 9.0]},
            foot_lin_vel_w={"left": [speed, 0.0, 0.0]},
        )
        env = make_env(1, signals=posed.signals)
        return url.foot_clearance_world_exp(env, target=0.1, std=math.sqrt(0.05), speed_scale=2.0).item()

    assert score(0.1) == pytest.approx(1.0)
    assert score(0.4) == pytest.approx(math.exp(-(0.3**2) * math.tanh(2.0) / 0.05), abs=1e-5)
    assert score(0.4, speed=0.0) == 1.0
