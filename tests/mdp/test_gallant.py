"""Gallant's rewards, observations and terminations in closed form, on hand-made states."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
import torch

from humoslope.errors import UserError
from humoslope.managers.goal import GoalCommand, GoalCommandCfg
from humoslope.mdp import gallant
from humoslope.slope import quaternion
from humoslope.terrain import TerrainQueries
from robots.unitree_g1 import UNITREE_G1
from tests.mdp.conftest import plane

JOINTS = UNITREE_G1.joint_names
UPRIGHT = [1.0, 0.0, 0.0, 0.0]


def goals(env, to=(4.0, 0.0), elapsed=0.0) -> GoalCommand:
    """Goals at `to` whose time began `elapsed` s ago."""
    command = object.__new__(GoalCommand)
    command._env, command.cfg = env, GoalCommandCfg()
    command.goal_w = torch.tensor([to])
    command._since = env.steps_since_reset - round(elapsed / env.step_dt)
    return command


@pytest.fixture
def make(make_env):
    """make(to=..., elapsed=..., bodies={...}, slope=..., **signals): one env in this state."""

    def make(to=(4.0, 0.0), elapsed=0.0, bodies=None, slope=0.0, **signals):
        values = {
            "root_pos_w": [0.0, 0.0, 0.8],
            "root_quat_w": UPRIGHT,
            "torso_quat_w": UPRIGHT,
            "root_lin_vel_w": [0.0, 0.0, 0.0],
            "heading_w": 0.0,
            "projected_gravity_b": [0.0, 0.0, -1.0],
            "foot_force_w": [[0.0, 0.0, 0.0]] * 2,
            "foot_lin_vel_w": [[0.0, 0.0, 0.0]] * 2,
            "foot_contact": [True, True],
        } | signals
        poses = {"torso_link": ([0.0, 0.0, 0.8], UPRIGHT)} | (bodies or {})
        env = make_env(
            1,
            signals=SimpleNamespace(**{name: torch.tensor([value]) for name, value in values.items()}),
            bodies=SimpleNamespace(
                position=lambda name: torch.tensor([poses[name][0]]),
                rotation=lambda name: quaternion.matrix(torch.tensor([poses[name][1]])),
            ),
            terrain=TerrainQueries(plane(slope), "cpu"),
            robot=UNITREE_G1,
            steps_since_reset=torch.tensor([1000]),
        )
        env.commands = goals(env, to, elapsed)
        return env

    return make


def joints(**values: float) -> torch.Tensor:
    return torch.tensor([[values.get(name.removesuffix("_joint"), 0.0) for name in JOINTS]])


def turned(yaw=0.0, pitch=0.0) -> list[float]:
    """Orientation by a yaw and a pitch, degrees; a positive pitch leans forward."""
    y, p = 0.5 * math.radians(yaw), 0.5 * math.radians(pitch)
    return [math.cos(y) * math.cos(p), -math.sin(y) * math.sin(p), math.cos(y) * math.sin(p), math.sin(y) * math.cos(p)]


def test_the_goal_is_seen_from_the_torso_in_its_heading(make):
    env = make(to=(4.0, 1.0), elapsed=3.0, bodies={"torso_link": ([1.0, 0.0, 0.8], UPRIGHT)})
    env.signals.torso_quat_w = torch.tensor([turned(yaw=90.0, pitch=20.0)])
    # 3 m along x and 1 m along y: to the right and ahead of who looks along y. The lean does not matter.
    assert gallant.goal_command(env)[0].tolist() == pytest.approx([1.0, -3.0, 3.0, 7.0], abs=1e-5)


@pytest.mark.parametrize(
    ("velocity", "to", "expected"),
    [
        ([0.3, 0.0, 9.0], (4.0, 0.0), 1.0),
        ([0.0, -2.0, 0.0], (4.0, 0.0), 0.0),
        ([-1.0, 0.0, 0.0], (4.0, 0.0), -1.0),
        ([1.0, 0.0, 0.0], (3.0, 4.0), 0.6),
        ([-1.0, 0.0, 0.0], (0.1, 0.1), 1.0),  # at the goal
        ([0.0, 0.0, 0.0], (4.0, 0.0), 0.0),
    ],
)
def test_the_direction_of_the_velocity_counts_and_not_its_size(make, velocity, to, expected):
    assert gallant.velocity_direction(make(to=to, root_lin_vel_w=velocity)).item() == pytest.approx(expected)


@pytest.mark.parametrize(
    ("to", "elapsed", "expected"),
    [((1.2, 0.2), 9.0, 0.5), ((0.2, -0.2), 9.0, 1.0), ((1.2, 2.2), 9.0, 1 / 6), ((1.2, 0.2), 7.9, 0.0)],
)
def test_a_place_near_the_goal_counts_in_the_last_two_seconds(make, to, elapsed, expected):
    assert gallant.reach_goal(make(to=to, elapsed=elapsed)).item() == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(("to", "elapsed", "expected"), [((0.1, 0.1), 9, 1.0), ((0.1, 0.1), 7, 0.0), ((0.3, 0), 9, 0)])
def test_to_be_there_counts_then_too(make, to, elapsed, expected):
    assert gallant.at_goal(make(to=to, elapsed=float(elapsed))).item() == expected


@pytest.mark.parametrize(("to", "heading", "expected"), [((0.0, 4.0), 0.0, 0.25), ((-4.0, 0.0), 3.0, 0.0020317)])
def test_a_heading_off_the_goal_costs_its_square_in_half_turns(make, to, heading, expected):
    assert gallant.heading_off_goal(make(to=to, heading_w=heading)).item() == pytest.approx(expected, abs=1e-6)
    assert gallant.heading_off_goal(make(to=(0.0, 0.1), heading_w=heading)).item() == 0.0


@pytest.mark.parametrize(("speed", "expected"), [(0.0, 1.0), (0.39, 1.0), (0.5, 0.0), (0.79, 0.0), (0.81, 1.0)])
def test_a_pace_outside_of_the_band_costs_except_at_the_goal(make, speed, expected):
    velocity = [0.6 * speed, -0.8 * speed, 3.0]
    assert gallant.off_pace(make(root_lin_vel_w=velocity), (0.4, 0.8)).item() == expected
    assert gallant.off_pace(make(to=(0.0, 0.0), root_lin_vel_w=velocity), (0.4, 0.8)).item() == 0.0


@pytest.mark.parametrize(
    ("left", "right", "walking", "there"), [(9, 9, 0, 1), (9, 0, 1, 0), (0.05, 9, 1, 0), (0, 0, 0, 0)]
)
def test_one_foot_is_down_on_the_way_and_both_at_the_goal(make, left, right, walking, there):
    force = [[0.0, 0.0, float(left)], [0.0, 0.0, float(right)]]
    assert gallant.stance(make(foot_force_w=force)).item() == walking
    assert gallant.stance(make(to=(0.0, 0.0), foot_force_w=force)).item() == there


def test_a_head_at_its_height_is_worth_1_and_one_too_low_less_the_more_the_legs_are_at_their_ends(make):
    env = make(joint_pos=[0.0] * 29)
    env.joint_range = torch.tensor([[-1.0, 1.0]]).repeat(29, 1)
    assert gallant.head_height(env, target=1.35).item() == pytest.approx(1.0)
    assert gallant.head_height(env, target=1.45).item() == pytest.approx(math.exp(-0.04))
    env.signals.joint_pos = joints(left_knee=1.0, right_hip_pitch=-0.5)
    off = 0.5 + 0.25
    assert gallant.head_height(env, target=1.45).item() == pytest.approx(math.exp(-0.04) - 5.0 * off * 0.1, abs=1e-5)


def test_the_head_follows_the_lean_of_the_root_and_the_ground_below_it(make):
    env = make(slope=20.0, joint_pos=[0.0] * 29, root_quat_w=turned(pitch=30.0))
    env.joint_range = torch.tensor([[-1.0, 1.0]]).repeat(29, 1)
    height = 0.8 + 0.55 * math.cos(math.radians(30)) - 0.55 * math.sin(math.radians(30)) * math.tan(math.radians(20))
    assert gallant.head_height(env, target=height).item() == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(("pitch", "factor"), [(10.0, 1.0), (-10.0, 100.0)])
def test_a_lean_backward_costs_a_hundred_times_as_much_as_one_forward(make, pitch, factor):
    env = make(torso_quat_w=turned(yaw=50.0, pitch=pitch))
    expected = factor * math.sin(math.radians(pitch)) ** 2
    assert gallant.torso_lean(env).item() == pytest.approx(expected, rel=1e-4)
    env.signals.projected_gravity_b = torch.tensor([[math.sin(math.radians(pitch)), 0.1, -0.98]])
    assert gallant.pelvis_lean(env).item() == pytest.approx(expected + 25.0 * 0.01, rel=1e-4)


def test_vertical_speed_and_distances_from_the_default_pose_are_squared(make):
    env = make(root_lin_vel_w=[5.0, 5.0, -0.3], joint_pos=[0.0] * 29)
    assert gallant.lin_vel_z_l2(env).item() == pytest.approx(0.09)
    env.default_joint_pos = torch.zeros(29)
    env.signals.joint_pos = joints(left_knee=0.3, right_knee=-0.4, left_elbow=9.0)
    assert gallant.joint_deviation_l2(env, ".*_knee_joint").item() == pytest.approx(0.25)


@pytest.mark.parametrize(("apart", "expected"), [(0.1, 0.1), (0.2, 0.0), (0.28, 0.0), (0.4, 0.12)])
def test_the_distance_of_the_feet_is_across_the_heading(make, apart, expected):
    bodies = {"l": ([0.5, apart, 0.0], UPRIGHT), "r": ([-0.5, 0.0, 1.0], UPRIGHT)}
    feet = {"lefts": ("l",), "rights": ("r",), "span": (0.2, 0.28)}
    assert gallant.lateral_distance(make(bodies=bodies), **feet).item() == pytest.approx(expected, abs=1e-6)
    sideways = {name: ([-y, x, z], quat) for name, ((x, y, z), quat) in bodies.items()}
    env = make(bodies=sideways, heading_w=0.5 * math.pi)
    assert gallant.lateral_distance(env, **feet).item() == pytest.approx(expected, abs=1e-6)


def test_two_pairs_share_twice_the_span(make):
    bodies = {"a": ([0.0, 0.1, 0.0], UPRIGHT), "b": ([0.0, 0.5, 0.0], UPRIGHT), "c": ([0.0, 0.0, 0.0], UPRIGHT)}
    env = make(bodies=bodies)
    assert gallant.lateral_distance(env, ("a", "b"), ("c", "c"), (0.2, 0.28)).item() == pytest.approx(0.04, abs=1e-6)
    with pytest.raises(UserError, match="2 left and 1 right bodies; give pairs"):
        gallant.lateral_distance(env, ("a", "b"), ("c",), (0.2, 0.28))


def feet(left=(0.0, 0.1, 0.035), right=(0.0, -0.1, 0.035), yaw=(0.0, 0.0), pitch=0.0):
    names = UNITREE_G1.foot_bodies
    places, quats = (left, right), [turned(y, pitch) for y in yaw]
    return {name: (list(place), quat) for name, place, quat in zip(names, places, quats, strict=True)}


def test_feet_that_point_apart_cost_one_less_the_cosine(make):
    env = make(bodies=feet(yaw=(20.0, -40.0)))
    assert gallant.feet_apart_in_yaw(env).item() == pytest.approx(0.5, abs=1e-6)


def test_ten_points_of_two_flat_feet_are_down_when_they_have_been_so_for_a_step(make):
    env = make(bodies=feet(right=(0.0, -0.1, 0.034)))
    term = gallant.SolePointsDown(env, near=0.0351)
    assert [term(env).item(), term(env).item()] == [0.0, 10.0]
    env.signals.foot_contact = torch.tensor([[True, False]])
    assert term(env).item() == 5.0
    term.reset(torch.tensor([True]))
    assert term(env).item() == 0.0


def test_of_a_foot_on_its_toe_only_the_points_near_the_ground_count(make):
    pitched = feet(
        left=(0.0, 0.1, 0.034), right=(0.0, -0.1, 0.3), pitch=5.0
    )  # the toe is 7 mm lower, the heel 2 higher
    env = make(bodies=pitched)
    term = gallant.SolePointsDown(env, near=0.035)
    term(env)
    assert term(env).item() == 4.0


@pytest.mark.parametrize(("degrees", "points"), [(8.0, 10.0), (20.0, 0.0)])
def test_flat_feet_on_a_slope_are_beyond_the_threshold_as_published(make, degrees, points):
    tilt, over = math.radians(degrees), 0.0345 / math.cos(math.radians(degrees))  # half a millimetre of penetration
    env = make(slope=degrees, bodies=feet(left=(0.0, 0.1, over), right=(0.0, -0.1, over), pitch=-degrees))
    term = gallant.SolePointsDown(env)
    term(env)
    assert term(env).item() == points
    assert tilt > 0.0


def test_slip_counts_for_feet_on_the_ground(make):
    env = make(foot_lin_vel_w=[[0.3, 0.4, 5.0], [1.0, 0.0, 0.0]], foot_contact=[True, False])
    assert gallant.slip_l2(env).item() == pytest.approx(0.25)


def test_a_low_foot_costs_by_its_missing_height_and_speed_against_the_root(make):
    env = make(
        bodies=feet(left=(0.0, 0.1, 0.03), right=(0.0, -0.1, 0.2)),
        root_lin_vel_w=[0.5, 0.0, 0.0],
        foot_lin_vel_w=[[1.5, 0.0, 9.0], [3.0, 0.0, 0.0]],
    )
    assert gallant.low_swing(env).item() == pytest.approx(0.02**2 * 1.0, rel=1e-4)
    uphill = make(
        slope=20.0,
        bodies=feet(left=(0.0, 0.1, 0.03), right=(0.0, -0.1, 0.2)),
        foot_lin_vel_w=[[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
    )
    ahead = 0.5 * 0.15 * math.tan(math.radians(20.0))  # half of the rise to the place ahead
    assert gallant.low_swing(uphill).item() == pytest.approx((0.02 + ahead) ** 2, rel=1e-3)


def test_a_pitched_foot_costs_in_its_first_three_steps_off_the_ground(make):
    env = make(bodies=feet(pitch=10.0))
    term = gallant.PitchedLiftOff(env)
    cost = 2.0 * (0.18 * math.sin(math.radians(10.0))) ** 2  # in the world and over the ground
    assert term(env).item() == 0.0
    env.signals.foot_contact = torch.tensor([[False, True]])
    assert [term(env).item() for _ in range(4)] == pytest.approx([cost, cost, cost, 0.0], abs=1e-6)
    term.reset(torch.tensor([True]))
    assert term(env).item() == 0.0


def test_a_foot_flat_on_a_slope_costs_in_the_world_alone(make):
    env = make(slope=10.0, bodies=feet(pitch=-10.0))
    term = gallant.PitchedLiftOff(env)
    term(env)
    env.signals.foot_contact = torch.tensor([[False, True]])
    assert term(env).item() == pytest.approx((0.18 * math.sin(math.radians(10.0))) ** 2, rel=1e-3)


@pytest.mark.parametrize(("force", "expected"), [([31.0, 0.0, 10.0], 1.0), ([29.0, 0.0, 10.0], 0.0), ([0, 0, 0], 0.0)])
def test_a_foot_stumbles_by_three_times_as_much_force_to_a_side_as_up(make, force, expected):
    env = make(foot_force_w=[[0.0, 0.0, 300.0], [float(f) for f in force]])
    assert gallant.stumble(env).item() == expected


def test_heavy_feet_and_hard_landings_cost_what_is_beyond_the_free_force(make):
    env = make(foot_force=[300.0, 260.0], foot_force_w=[[0.0, 0.0, 150.0], [0.0, 0.0, 40.0]])
    env.signals.foot_lin_vel_w = torch.tensor([[[0.0, 0.0, -0.5], [0.0, 0.0, -2.0]]])
    assert gallant.heavy_feet(env).item() == pytest.approx(60.0)
    assert gallant.landing_momentum(env).item() == pytest.approx(50.0)
    env.signals.foot_lin_vel_w = -env.signals.foot_lin_vel_w
    assert gallant.landing_momentum(env).item() == 0.0


def test_effort(make):
    env = make(joint_vel=[0.0] * 29, joint_torque=[0.0] * 29, body_force=7.0)
    env.signals.joint_vel = joints(left_knee=-20.0, left_hip_pitch=30.0)
    env.signals.joint_torque = joints(left_knee=139.0, left_hip_pitch=-80.0)
    env.drives = SimpleNamespace(nominal_stiffness=torch.full((29,), 10.0))
    assert gallant.body_force(env).item() == 7.0
    assert gallant.power_l2(env).item() == pytest.approx(2.78**2 + 2.4**2)
    assert gallant.torque_over_stiffness_l2(env).item() == pytest.approx(13.9**2 + 8.0**2)
    # Limits of the URDF: 32 rad/s for the hip; the knee turns fast in the direction that does not count.
    assert gallant.FastJoints(env)(env).item() == pytest.approx(30.0 - 0.8 * 32.0, rel=1e-5)
    assert gallant.StrongJoints(env)(env).item() == pytest.approx(0.05 * 139.0, rel=1e-5)


def test_terminations(make):
    env = make(bodies=feet(left=(0.0, 0.03, 0.0), right=(0.0, -0.01, 9.0)), body_force=99.0)
    assert not gallant.hit(env, 100.0).any()
    assert gallant.hit(env, 98.0).all()
    assert gallant.feet_too_close(env, 0.05).all()
    assert not gallant.feet_too_close(env, 0.03).any()


@pytest.mark.parametrize(
    ("step", "away", "ends"), [(200, 0.9, True), (200, 1.1, False), (199, 0.9, False), (201, 0, False)]
)
def test_who_has_not_moved_a_metre_in_four_seconds_has_failed(make, step, away, ends):
    env = make(root_pos_w=[0.6 * away, -0.8 * away, 5.0])
    env.start_root_pos_w, env.steps_since_reset = torch.zeros(1, 3), torch.tensor([step])
    assert gallant.not_moving(env, 1.0, 4.0).tolist() == [ends]


def test_without_goals_it_is_said_what_is_missing(make_env):
    with pytest.raises(UserError, match="set env.command to a GoalCommandCfg"):
        gallant.goal_of(make_env(1, commands=None))
