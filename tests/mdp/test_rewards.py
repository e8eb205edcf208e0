"""Rewards on hand-made states."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from humoslope.errors import UserError
from humoslope.mdp import rewards
from robots.unitree_g1 import UNITREE_G1

slopes = st.floats(-40.0, 40.0)
headings = st.floats(-180.0, 180.0)


def command(*velocity):
    return SimpleNamespace(velocity=torch.tensor([velocity]))


def quat(euler, angles):
    return Rotation.from_euler(euler, angles, degrees=True).as_quat(scalar_first=True)


# Velocity along the ground


def test_climbing_a_slope_of_thirty_degrees_at_the_commanded_speed_along_it_scores_one(make_env, pose):
    climbing = 0.5 * np.array([math.cos(math.radians(30.0)), 0.0, math.sin(math.radians(30.0))])
    signals = pose(30.0, root_lin_vel_w=climbing).signals
    env = make_env(1, signals=signals, commands=command(0.5, 0.0, 0.0))
    assert rewards.track_slope_velocity_exp(env, std=0.25).item() == pytest.approx(1.0, abs=1e-6)
    assert rewards.slope_normal_velocity_l2(env).item() == pytest.approx(0.0, abs=1e-9)


@given(slope=slopes, uphill=headings, heading=headings, forward=st.floats(-1.0, 1.0), left=st.floats(-1.0, 1.0))
def test_velocity_along_the_ground_is_read_right_on_any_slope_in_any_direction(
    make_env, pose, slope, uphill, heading, forward, left
):
    ground = Rotation.from_euler("ZY", [uphill, -slope], degrees=True)
    normal = ground.apply([0.0, 0.0, 1.0])
    facing = np.array([math.cos(math.radians(heading)), math.sin(math.radians(heading)), 0.0])
    ahead = facing - np.array([0.0, 0.0, facing @ normal / normal[2]])  # right above the heading, in the plane
    ahead /= np.linalg.norm(ahead)
    velocity = forward * ahead + left * np.cross(normal, ahead)
    signals = pose(slope, uphill, root_quat_w=quat("z", heading), root_lin_vel_w=velocity).signals
    env = make_env(1, signals=signals, commands=command(forward, left, 0.0))
    assert rewards.track_slope_velocity_exp(env, std=0.25).item() == pytest.approx(1.0, abs=1e-5)
    assert rewards.slope_normal_velocity_l2(env).item() == pytest.approx(0.0, abs=1e-6)
    assert signals.slope_pitch.item() == pytest.approx(math.asin(ahead[2]), abs=1e-4)


@given(slope=slopes, error=st.floats(0.0, 1.0))
def test_the_reward_falls_to_one_over_e_at_an_error_of_std(make_env, pose, slope, error):
    along = np.array([math.cos(math.radians(slope)), 0.0, math.sin(math.radians(slope))])
    signals = pose(slope, root_lin_vel_w=0.3 * along).signals
    env = make_env(1, signals=signals, commands=command(0.3 + error, 0.0, 0.0))
    expected = math.exp(-((error / 0.5) ** 2))
    assert rewards.track_slope_velocity_exp(env, std=0.5).item() == pytest.approx(expected, abs=1e-5)


def test_jumping_off_the_slope_is_speed_out_of_the_ground(make_env, pose):
    normal = np.array([-math.sin(math.radians(20.0)), 0.0, math.cos(math.radians(20.0))])
    env = make_env(1, signals=pose(20.0, root_lin_vel_w=0.7 * normal).signals)
    assert rewards.slope_normal_velocity_l2(env).item() == pytest.approx(0.49, abs=1e-5)


@given(pitch=st.floats(-40.0, 40.0), roll=st.floats(-40.0, 40.0), rate=st.floats(-1.0, 1.0))
def test_turning_is_measured_about_the_vertical_however_the_pelvis_leans(make_env, pose, pitch, roll, rate):
    lean = Rotation.from_euler("ZYX", [30.0, pitch, roll], degrees=True)
    spin = lean.inv().apply([0.0, 0.0, rate])
    signals = pose(root_quat_w=lean.as_quat(scalar_first=True), root_ang_vel_b=spin).signals
    env = make_env(1, signals=signals, commands=command(0.0, 0.0, rate))
    assert rewards.track_yaw_rate_exp(env, std=0.5).item() == pytest.approx(1.0, abs=1e-5)
    env.commands = command(0.0, 0.0, rate + 0.5)
    assert rewards.track_yaw_rate_exp(env, std=0.5).item() == pytest.approx(math.exp(-1.0), abs=1e-5)


@pytest.mark.parametrize(("rate", "asked"), [(0.3, 0.3), (0.0, 0.4), (-0.2, 0.3)])
def test_a_sway_is_gone_in_the_mean_yaw_rate_and_an_error_is_not(make_env, rate, asked):
    """A sway of 1 rad/s with a period of 0.4 s about a constant rate."""
    env = make_env(1, commands=command(0.0, 0.0, asked))
    term = rewards.TrackMeanYawRate(env, std=0.5, memory_s=0.4)
    rewarded = []
    for i in range(300):
        turn = rate + math.sin(2.0 * math.pi * i * env.step_dt / 0.4)
        gravity, spin = torch.tensor([[0.0, 0.0, -1.0]]), torch.tensor([[0.0, 0.0, turn]])
        env.signals = SimpleNamespace(projected_gravity_b=gravity, root_ang_vel_b=spin)
        rewarded.append(term(env).item())
    assert np.mean(rewarded[-100:]) == pytest.approx(math.exp(-(((rate - asked) / 0.5) ** 2)), abs=0.08)
    term.reset(torch.tensor([True]))
    env.commands = command(0.0, 0.0, turn)
    assert term(env).item() == pytest.approx(1.0, abs=1e-6)


# Posture


@pytest.mark.parametrize("slope", [-30.0, 30.0])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_on_a_slope_the_pelvis_may_lean_by_its_share_forward_and_back(make_env, pose, slope, side):
    def cost(lean):
        env = make_env(1, signals=pose(slope, root_quat_w=quat("y", side * lean)).signals)
        return rewards.pitch_l2(env, slope_share=0.7).item()

    assert cost(0.0) == 0.0
    assert cost(20.9) == 0.0
    assert cost(30.0) == pytest.approx((math.sin(math.radians(30.0)) - math.sin(math.radians(21.0))) ** 2, abs=1e-5)


def test_on_the_flat_every_lean_costs(make_env, pose):
    env = make_env(1, signals=pose(0.0, root_quat_w=quat("y", 10.0)).signals)
    assert rewards.pitch_l2(env, slope_share=0.7).item() == pytest.approx(math.sin(math.radians(10.0)) ** 2, abs=1e-6)


def test_walking_across_a_slope_allows_no_lean_forward(make_env, pose):
    across = Rotation.from_euler("ZY", [90.0, 10.0], degrees=True).as_quat(scalar_first=True)
    env = make_env(1, signals=pose(30.0, root_quat_w=across).signals)
    assert rewards.pitch_l2(env, slope_share=0.7).item() == pytest.approx(math.sin(math.radians(10.0)) ** 2, abs=1e-5)


def test_roll_costs_and_pitch_does_not_count_as_roll(make_env, pose):
    rolled = make_env(1, signals=pose(root_quat_w=quat("x", 15.0)).signals)
    pitched = make_env(1, signals=pose(root_quat_w=quat("y", 15.0)).signals)
    assert rewards.roll_l2(rolled).item() == pytest.approx(math.sin(math.radians(15.0)) ** 2, abs=1e-6)
    assert rewards.roll_l2(pitched).item() == pytest.approx(0.0, abs=1e-9)


def test_roll_and_pitch_rates_cost_and_yaw_rate_does_not(make_env, pose):
    env = make_env(1, signals=pose(root_ang_vel_b=[0.3, -0.4, 5.0]).signals)
    assert rewards.ang_vel_xy_l2(env).item() == pytest.approx(0.25)


def test_the_height_of_the_root_is_taken_over_the_ground_below_it(make_env, pose):
    ground = 2.0 * math.tan(math.radians(25.0))
    env = make_env(1, signals=pose(25.0, root_pos_w=[2.0, 0.0, ground + 0.65]).signals)
    assert rewards.root_height_l2(env, target=0.75).item() == pytest.approx(0.01, abs=1e-5)


# Joints


def joints(**values):
    """One robot at its default pose but for these joints."""
    pos = torch.tensor([UNITREE_G1.default_joint_pos])
    for name, value in values.items():
        pos[0, UNITREE_G1.joint_names.index(name)] = value
    return pos


def default():
    return torch.tensor(UNITREE_G1.default_joint_pos)


OF_THREE_JOINTS = dataclasses.replace(UNITREE_G1, joint_names=("hip", "knee", "ankle"))


def test_joints_beyond_the_soft_share_of_their_range_cost_how_far(make_env):
    limits = torch.tensor([[-1.0, 3.0], [-1.0, 1.0], [0.0, 2.0]])
    pos = torch.tensor([[2.9, -0.95, 1.0], [1.0, 0.0, 1.0], [3.5, 0.0, -0.5]])
    env = make_env(3, robot=OF_THREE_JOINTS, joint_range=limits, signals=SimpleNamespace(joint_pos=pos))
    # The soft ranges are [-0.8, 2.8], [-0.9, 0.9] and [0.1, 1.9].
    expected = torch.tensor([0.1 + 0.05, 0.0, 0.7 + 0.6])
    torch.testing.assert_close(rewards.joint_pos_limits(env, soft=0.9), expected, atol=1e-6, rtol=0)


def test_only_joints_that_the_pattern_names_deviate(make_env):
    pos = joints(waist_yaw_joint=0.3, waist_roll_joint=-0.2, left_knee_joint=2.0)
    env = make_env(1, robot=UNITREE_G1, default_joint_pos=default(), signals=SimpleNamespace(joint_pos=pos))
    assert rewards.joint_deviation_l1(env, "waist.*").item() == pytest.approx(0.5)
    assert rewards.joint_deviation_l1(env, "right.*").item() == 0.0


def test_a_pattern_must_match_whole_names_and_one_that_matches_nothing_is_a_mistake(make_env):
    env = make_env(1, robot=UNITREE_G1, default_joint_pos=default(), signals=SimpleNamespace(joint_pos=joints()))
    with pytest.raises(UserError, match="joint pattern 'knee' matches nothing; unitree_g1 has left_hip_pitch_joint"):
        rewards.joint_deviation_l1(env, "knee")


def test_power_counts_alike_whether_a_joint_drives_or_brakes(make_env):
    velocity, torque = torch.tensor([[2.0, -3.0]]), torch.tensor([[10.0, 10.0]])
    env = make_env(1, signals=SimpleNamespace(joint_vel=velocity, joint_torque=torque))
    assert rewards.energy(env).item() == pytest.approx(50.0)


def test_joint_accelerations_are_differences_over_a_step_and_none_across_a_reset(make_env, mask):
    env = make_env(2, robot=OF_THREE_JOINTS, signals=SimpleNamespace(joint_vel=torch.zeros(2, 3)))
    term = rewards.JointAccelerationL2(env)
    assert term(env).tolist() == [0.0, 0.0]
    env.signals = SimpleNamespace(joint_vel=torch.full((2, 3), 0.1))
    torch.testing.assert_close(term(env), torch.full((2,), 3 * 25.0))
    term.reset(mask(2, 1))
    env.signals = SimpleNamespace(joint_vel=torch.full((2, 3), 0.2))
    torch.testing.assert_close(term(env), torch.tensor([75.0, 0.0]), atol=1e-3, rtol=0)


def test_changing_the_action_costs_its_square(make_env):
    actions = SimpleNamespace(action=torch.tensor([[1.0, -2.0]]), previous_action=torch.tensor([[0.0, 0.0]]))
    assert rewards.action_rate_l2(make_env(1, actions=actions)).item() == 5.0


# Feet and contacts


def test_only_feet_on_the_ground_slide(make_env, pose):
    posed = pose(
        foot_lin_vel_w={"left": [0.3, 0.4, 0.0], "right": [5.0, 0.0, 0.0]}, foot_force_w={"left": [0.0, 0.0, 200.0]}
    )
    assert rewards.foot_slide(make_env(1, signals=posed.signals)).item() == pytest.approx(0.5)


def clearance(env):
    return rewards.foot_clearance_exp(env, target=0.08, std=0.1, speed_scale=2.0).item()


def test_feet_that_stand_may_be_at_any_height(make_env, pose):
    posed = pose(foot_pos_w={"left": [0.0, 0.1, 0.0], "right": [0.0, -0.1, 0.5]})
    assert clearance(make_env(1, signals=posed.signals)) == 1.0


def test_a_moving_foot_scores_best_at_the_target_height_above_the_ground_below_it(make_env, pose):
    ground = 1.0 * math.tan(math.radians(20.0))

    def score(height):
        posed = pose(
            20.0,
            foot_pos_w={"left": [1.0, 0.1, ground + height], "right": [0.0, -0.1, 0.0]},
            foot_lin_vel_w={"left": [1.0, 0.0, 0.0]},
        )
        return clearance(make_env(1, signals=posed.signals))

    assert score(0.08) == pytest.approx(1.0, abs=1e-5)
    assert score(0.0) == pytest.approx(math.exp(-(0.08**2) * math.tanh(2.0) / 0.1**2), abs=1e-4)
    assert score(0.02) < score(0.05) < score(0.08) > score(0.2)


def test_lifting_a_foot_straight_up_is_no_stride(make_env, pose):
    posed = pose(foot_lin_vel_w={"left": [0.0, 0.0, 1.0]}, foot_pos_w={"left": [0.0, 0.1, 0.3]})
    assert clearance(make_env(1, signals=posed.signals)) == 1.0


@pytest.mark.parametrize(("ground_force", "touches"), [(200.0, 0.0), (200.5, 0.0), (260.0, 1.0)])
def test_ground_force_that_no_foot_carries_is_a_body_contact(make_env, pose, ground_force, touches):
    posed = pose(foot_force_w={"left": [0.0, 0.0, 200.0]}, robot_force_w=[0.0, 0.0, ground_force])
    assert rewards.body_contact(make_env(1, signals=posed.signals), force=1.0).item() == touches


@pytest.mark.parametrize(
    ("force", "touches"), [([0.0, 0.0, 0.0], 0.0), ([9.0, 0.0, 0.0], 0.0), ([8.0, -6.1, 0.0], 1.0)]
)
def test_the_robot_touches_itself_when_its_strongest_contact_exceeds_the_threshold(pose, make_env, force, touches):
    posed = pose(self_force=force)
    assert rewards.self_contact(make_env(1, signals=posed.signals), force=10.0).item() == touches


def test_being_alive_earns_and_only_a_failure_is_a_fall(make_env):
    env = make_env(2, terminations=SimpleNamespace(terminated=torch.tensor([True, False])))
    assert rewards.alive(env).tolist() == [1.0, 1.0]
    assert rewards.fall(env).tolist() == [1.0, 0.0]


# Single stance

LEFT, RIGHT, BOTH, NONE = (False, True), (True, False), (True, True), (False, False)
"""Contact of left and right foot; named by the leg that is lifted."""


@pytest.fixture
def stepper(make_env):
    """Feeds contacts to a fresh term, the same in two worlds, and returns what it is worth."""
    env = make_env(2, commands=SimpleNamespace(moving=torch.tensor([True, True])))
    env.signals = SimpleNamespace(foot_contact=torch.tensor([BOTH, BOTH]))
    term = rewards.SingleStance(env, cap=0.1, transfer=0.04)

    def step(contact, moving=True):
        env.signals = SimpleNamespace(foot_contact=torch.tensor([contact, contact]))
        env.commands.moving = torch.tensor([moving, moving])
        return [round(value, 4) for value in term(env).tolist()]

    step.term = term
    return step


def test_standing_on_one_leg_is_worth_the_time_since_a_foot_landed_up_to_the_cap_and_nothing_from_then_on(stepper):
    stepper(LEFT)
    stepper(BOTH)  # lands
    values = [stepper(LEFT)[0] for _ in range(7)]
    assert values == [0.2, 0.4, 0.6, 0.8, 1.0, 0.0, 0.0]


def test_both_feet_may_be_down_for_a_moment_after_a_landing(stepper):
    stepper(LEFT)
    assert stepper(BOTH) == [0.0, 0.0]
    assert stepper(BOTH) == [0.2, 0.2]
    assert stepper(BOTH) == [0.0, 0.0]  # 0.04 s are over
    assert stepper(RIGHT) == [0.6, 0.6]


def test_short_steps_are_worth_little(stepper):
    for _ in range(3):
        stepper(BOTH)
    stepper(LEFT)
    stepper(LEFT)
    assert stepper(RIGHT) == [0.0, 0.0]  # has only just landed
    assert stepper(RIGHT) == [0.2, 0.2]


def test_on_both_legs_or_in_the_air_it_is_worth_nothing(stepper):
    for _ in range(10):
        stepper(LEFT)
    assert stepper(BOTH) == [0.0, 0.0]
    stepper(BOTH)
    assert stepper(BOTH) == [0.0, 0.0]
    assert stepper(NONE) == [0.0, 0.0]
    assert stepper(NONE) == [0.0, 0.0]


def test_who_is_asked_to_stand_earns_nothing_on_one_leg(stepper):
    for _ in range(10):
        stepper(LEFT)
    assert stepper(LEFT, moving=False) == [0.0, 0.0]


def test_a_reset_forgets_the_time_of_its_worlds_alone(stepper, mask):
    for _ in range(3):
        stepper(LEFT)
    assert stepper(LEFT) == [0.8, 0.8]
    stepper.term.reset(mask(2, 1))
    assert stepper(LEFT) == [1.0, 0.2]


# Prices of a gait


def test_every_landing_costs_its_rate_and_the_first_contacts_of_an_episode_are_none(make_env):
    env = make_env(1, signals=SimpleNamespace(foot_contact=torch.tensor([NONE])))
    term = rewards.LandingRate(env)

    def step(contact):
        env.signals = SimpleNamespace(foot_contact=torch.tensor([contact]))
        return round(term(env).item() * env.step_dt)

    assert [step(contact) for contact in (BOTH, LEFT, BOTH, BOTH, NONE, BOTH)] == [0, 0, 1, 0, 0, 2]
    step(NONE)
    term.reset(torch.tensor([True]))
    assert step(BOTH) == 0


def test_chatter_costs_four_times_as_much_in_second_differences_as_in_first_ones(make_env):
    env = make_env(1, robot=SimpleNamespace(num_joints=2), actions=SimpleNamespace())
    term = rewards.ActionAccelerationL2(env)

    def step(before, now):
        env.actions.previous_action, env.actions.action = torch.tensor([before]), torch.tensor([now])
        return term(env).item(), rewards.action_rate_l2(env).item()

    assert step([0.0, 0.0], [1.0, 2.0]) == (5.0, 5.0)
    assert step([1.0, 2.0], [0.0, 0.0]) == (20.0, 5.0)
    assert step([0.0, 0.0], [-1.0, -2.0]) == (0.0, 5.0)  # goes on as before
    term.reset(torch.tensor([True]))
    assert step([0.0, 0.0], [1.0, 0.0]) == (1.0, 1.0)


def test_knees_cost_their_mean_flexion_beyond_what_is_free(make_env):
    knees = [UNITREE_G1.joint_names.index(f"{side}_knee_joint") for side in ("left", "right")]
    joint_pos = torch.full((2, 29), 1.0)
    joint_pos[0, knees] = torch.tensor([0.9, 0.3])
    joint_pos[1, knees] = torch.tensor([0.4, -0.1])
    env = make_env(2, robot=UNITREE_G1, signals=SimpleNamespace(joint_pos=joint_pos))
    assert rewards.knee_flexion_l1(env, free=0.4).tolist() == pytest.approx([0.25, 0.0])
