"""Isaac Lab's terms, on hand-made states."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch

from humoslope.mdp import isaac_lab, rewards
from robots.unitree_g1 import UNITREE_G1

JOINTS = UNITREE_G1.joint_names
CPU = torch.device("cpu")


def stepping(make_env, speed=0.5):
    commands = SimpleNamespace(velocity=torch.tensor([[speed, 0.0, 0.0]]))
    signals = SimpleNamespace(foot_contact=torch.tensor([[True, True]]))
    return make_env(1, signals=signals, commands=commands)


def walk(env, term, *contacts):
    earned = []
    for left, right in contacts:
        env.signals.foot_contact = torch.tensor([[left, right]])
        earned.append(term(env).item())
    return earned


def test_time_on_one_leg_is_that_since_a_foot_last_landed_or_lifted_up_to_the_threshold(make_env):
    env = stepping(make_env)
    term = isaac_lab.FeetAirTime(env, threshold=0.06)
    down, left_up, right_up = (True, True), (False, True), (True, False)
    earned = walk(env, term, down, down, left_up, left_up, left_up, left_up, down, right_up, right_up)
    assert earned == pytest.approx([0.0, 0.0, 0.02, 0.04, 0.06, 0.06, 0.0, 0.02, 0.04])
    term.reset(torch.tensor([True]))
    assert walk(env, term, right_up) == pytest.approx([0.02])


def test_nothing_is_earned_on_one_leg_without_a_command_or_in_the_air(make_env):
    env = stepping(make_env, speed=0.05)
    assert walk(env, isaac_lab.FeetAirTime(env, threshold=0.4), (True, False), (True, False)) == [0.0, 0.0]
    env = stepping(make_env)
    assert walk(env, isaac_lab.FeetAirTime(env, threshold=0.4), (False, False), (False, False)) == [0.0, 0.0]


def test_torques_accelerations_and_limits_count_for_the_named_joints_alone(make_env):
    knee, wrist = JOINTS.index("left_knee_joint"), JOINTS.index("left_wrist_yaw_joint")
    values = torch.zeros(1, len(JOINTS))
    values[0, knee], values[0, wrist] = 3.0, 100.0
    limits = torch.tensor([[-1.0, 1.0]]).repeat(len(JOINTS), 1)
    signals = SimpleNamespace(joint_torque=values, joint_vel=torch.zeros_like(values), joint_pos=values)
    env = make_env(1, signals=signals, robot=UNITREE_G1, joint_range=limits)
    assert isaac_lab.joint_torques_l2(env, joints=".*_knee_joint").item() == 9.0
    assert rewards.joint_pos_limits(env, joints=".*_knee_joint", soft=0.9).item() == pytest.approx(2.1)
    assert rewards.joint_pos_limits(env, joints=".*_ankle_.*", soft=0.9).item() == 0.0
    term = rewards.JointAccelerationL2(env, joints=".*_knee_joint")
    assert term(env).item() == 0.0
    env.signals.joint_vel = 0.02 * values
    assert term(env).item() == pytest.approx(9.0)
    term.reset(torch.tensor([True]))
    env.signals.joint_vel = torch.zeros_like(values)
    assert term(env).item() == 0.0


@pytest.mark.parametrize(("force", "fails"), [(0.9, False), (1.1, True)])
def test_a_touch_of_trunk_or_arms_is_a_fall(make_env, force, fails):
    env = make_env(1, signals=SimpleNamespace(upper_force=torch.tensor([force])))
    assert isaac_lab.upper_contact(env, force=1.0).tolist() == [fails]
