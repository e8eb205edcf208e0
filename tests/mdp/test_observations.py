"""What the robot and the critic see, and how it looks in the mirror."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from humoslope.errors import UserError
from humoslope.mdp import observations
from humoslope.mdp.declare import joint_image
from robots.unitree_g1 import UNITREE_G1


def quat(euler, angles):
    return Rotation.from_euler(euler, angles, degrees=True).as_quat(scalar_first=True)


def seen(make_env, posed):
    return make_env(1, signals=posed.signals, height_scan=posed.height_scan, robot=UNITREE_G1)


def test_leaning_forward_gravity_points_ahead(make_env, pose):
    ahead = observations.projected_gravity(seen(make_env, pose(root_quat_w=quat("y", 20.0))))[0]
    expected = torch.tensor([math.sin(math.radians(20.0)), 0.0, -math.cos(math.radians(20.0))])
    torch.testing.assert_close(ahead, expected)


def test_velocity_is_seen_from_the_pelvis(make_env, pose):
    posed = pose(root_quat_w=quat("z", 90.0), root_lin_vel_w=[0.0, 0.5, 0.1])
    torch.testing.assert_close(
        observations.base_lin_vel(seen(make_env, posed)), torch.tensor([[0.5, 0.0, 0.1]]), atol=1e-6, rtol=0
    )


def test_the_load_of_a_foot_is_a_share_of_body_weight(make_env, pose):
    weight = UNITREE_G1.total_mass * 9.81
    posed = pose(foot_force_w={"left": [0.0, 0.6 * weight, 0.8 * weight], "right": [0.0, 0.0, 0.5]})
    env = seen(make_env, posed)
    torch.testing.assert_close(observations.foot_load(env), torch.tensor([[1.0, 0.5 / weight]]), atol=1e-5, rtol=0)
    assert observations.foot_contact(env).tolist() == [[1.0, 0.0]]


def test_standing_by_default_on_the_flat_the_scan_is_zero_everywhere(make_env, pose):
    posed = pose(root_pos_w=[0.3, -0.2, UNITREE_G1.default_root_height])
    scan = observations.height_scan(seen(make_env, posed))
    assert scan.shape == (1, 49)
    torch.testing.assert_close(scan, torch.zeros(1, 49), atol=1e-6, rtol=0)


@given(slope=st.floats(-35.0, 35.0), heading=st.floats(-180.0, 180.0))
def test_the_scan_reads_a_slope_ahead_and_to_the_left_in_the_robots_own_heading(make_env, pose, slope, heading):
    # Facing uphill at any heading the rows run ahead, 0.2 m apart; across them the ground is level.
    posed = pose(slope, heading, root_quat_w=quat("z", heading), root_pos_w=[0.0, 0.0, UNITREE_G1.default_root_height])
    scan = observations.height_scan(seen(make_env, posed), clip=10.0).view(7, 7)
    ahead = 0.2 * (torch.arange(7) - 3)
    expected = -math.tan(math.radians(slope)) * ahead[:, None].expand(7, 7)
    torch.testing.assert_close(scan, expected, atol=1e-4, rtol=0)


def test_the_scan_is_clipped(make_env, pose):
    posed = pose(root_pos_w=[0.0, 0.0, 9.0])
    assert (observations.height_scan(seen(make_env, posed), clip=1.0) == 1.0).all()


MIRRORED = {
    "slope": st.floats(-35.0, 35.0),
    "uphill": st.floats(-180.0, 180.0),
    "heading": st.floats(-180.0, 180.0),
    "y": st.floats(-3.5, 3.5),  # beyond the edge of the tile, 3 m from its middle, too
}


def in_the_mirror(make_env, pose, observe, slope, uphill, heading, y):
    """What is seen, its mirror image, and what is seen in the mirrored world."""

    def sight(side):
        posed = pose(slope, side * uphill, root_quat_w=quat("z", side * heading), root_pos_w=[0.4, side * y, 0.8])
        env = seen(make_env, posed)
        return env, observe(env)

    env, here = sight(1.0)
    index, sign = observe.mirror_image(env)
    return here, here[:, index] * sign, sight(-1.0)[1]


@given(**MIRRORED)
def test_the_scan_of_the_mirrored_world_is_the_mirrored_scan(make_env, pose, slope, uphill, heading, y):
    _, image, there = in_the_mirror(make_env, pose, observations.height_scan, slope, uphill, heading, y)
    torch.testing.assert_close(image, there, atol=1e-4, rtol=0)


@given(**MIRRORED)
def test_the_descriptor_of_the_mirrored_world_is_the_mirrored_descriptor(make_env, pose, slope, uphill, heading, y):
    here, image, there = in_the_mirror(make_env, pose, observations.terrain_descriptor, slope, uphill, heading, y)
    # Where the slope is at the edge of the dead band, or the tile leaves hardly more than a line, rounding decides.
    assume((here[0, 2] - math.radians(3.0)).abs() > 1e-3)
    assume(abs(y) < 2.8 or abs(y) > 3.0 + 0.6 * math.sqrt(2.0))
    torch.testing.assert_close(image, there, atol=1e-4, rtol=0)


@given(slope=st.floats(4.0, 35.0), heading=st.floats(-180.0, 180.0))
def test_the_critic_is_told_slope_bank_steepness_and_the_way_it_goes(make_env, pose, slope, heading):
    angle = math.radians(slope)
    for turn, expected in (
        (0.0, [angle, 0.0, angle, 1.0, 0.0]),
        (180.0, [-angle, 0.0, angle, 0.0, 1.0]),
        (90.0, [0.0, -angle, 0.0, 0.0, 0.0]),
    ):
        posed = pose(slope, heading, root_quat_w=quat("z", heading + turn))
        phi = observations.terrain_descriptor(seen(make_env, posed))
        torch.testing.assert_close(phi, torch.tensor([expected]), atol=1e-4, rtol=0)


def test_in_the_mirror_left_joints_are_right_ones_and_roll_and_yaw_turn_round():
    index, sign = joint_image(UNITREE_G1)
    mirrored = {
        name: (UNITREE_G1.joint_names[i], s)
        for name, i, s in zip(UNITREE_G1.joint_names, index.tolist(), sign.tolist(), strict=True)
    }
    assert mirrored["left_knee_joint"] == ("right_knee_joint", 1.0)
    assert mirrored["right_hip_roll_joint"] == ("left_hip_roll_joint", -1.0)
    assert mirrored["left_shoulder_yaw_joint"] == ("right_shoulder_yaw_joint", -1.0)
    assert mirrored["waist_yaw_joint"] == ("waist_yaw_joint", -1.0)
    assert mirrored["waist_pitch_joint"] == ("waist_pitch_joint", 1.0)


def test_the_default_pose_is_its_own_mirror_image():
    index, sign = joint_image(UNITREE_G1)
    pose = torch.tensor(UNITREE_G1.default_joint_pos)
    torch.testing.assert_close(pose[index] * sign, pose)


def test_a_robot_with_one_arm_has_no_mirror_image():
    one_armed = replace(UNITREE_G1, joint_names=("left_elbow_joint", "waist_yaw_joint"))
    with pytest.raises(UserError, match="joint 'left_elbow_joint' has no mirror image 'right_elbow_joint'"):
        joint_image(one_armed)
