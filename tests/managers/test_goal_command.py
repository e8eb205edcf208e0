"""Goals: where they lie, when there is another one, and the velocity that leads to them."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.managers import VelocityCommandCfg
from humoslope.managers.goal import PASSED, GoalCommandCfg

LENGTH, WIDTH = 35.0, 6.0


@pytest.fixture(scope="module")
def make_goals(make_env):
    def make(cfg=None, num_envs=1, x=0.5, y=0.0, heading=0.0, free=False, length=LENGTH, width=WIDTH):
        signals = SimpleNamespace(
            root_pos_w=torch.tensor([[x, y, 0.0]]).repeat(num_envs, 1), heading_w=torch.full((num_envs,), heading)
        )
        tiles = SimpleNamespace(
            origin_w=torch.zeros(num_envs, 3),
            omnidirectional=torch.full((num_envs,), free),
            has_omnidirectional=free,
            length=length,
            width=width,
        )
        steps = torch.zeros(num_envs, dtype=torch.int64)
        env = make_env(num_envs, signals=signals, tiles=tiles, steps_since_reset=steps)
        goals = (cfg or GoalCommandCfg()).build(env)
        goals.reset(torch.ones(num_envs, dtype=torch.bool))
        return goals

    return make


def track(speed: float = 0.5) -> GoalCommandCfg:
    """The command on a course, as the held-out track's protocol gives it."""
    asked = VelocityCommandCfg(
        speed=(speed, speed),
        heading_share=1.0,
        heading_gain=0.5,
        lateral_gain=0.6,
        yaw_rate_limit=0.2,
        standing_share=0.0,
    )
    return GoalCommandCfg().on_course(asked)


def test_a_goal_to_stand_at_does_not_follow_a_robot_that_creeps_away(make_goals):
    asked = VelocityCommandCfg(heading_share=1.0, standing_share=1.0)
    goals = make_goals(GoalCommandCfg().on_course(asked), x=10.0)
    for x in (10.1, 10.3, 10.6):
        walk(goals, to=(x, 0.0), seconds=1.0)
        assert goals.goal_w.tolist() == [[10.0, 0.0]]
        assert not goals.moving.any()
    walk(goals, to=(11.0, 0.0), seconds=8.0)  # its time is over
    assert goals.goal_w.tolist() == [[11.0, 0.0]]


def walk(goals, *, to=None, seconds: float = 0.02) -> None:
    """Lets time pass; the robot is then at `to`."""
    env = goals._env
    if to is not None:
        env.signals.root_pos_w = torch.tensor([[*to, 0.0]])
    env.steps_since_reset = env.steps_since_reset + round(seconds / 0.02)
    goals.step()


def test_at_half_a_metre_a_second_the_goal_is_the_originals_four_metres_ahead_on_the_centre_line(make_goals):
    goals = make_goals(track(), x=2.0, y=0.7, heading=0.3)
    assert goals.goal_w.tolist() == [[6.0, 0.0]]
    assert (goals.elapsed_s.item(), goals.left_s.item()) == (0.0, 10.0)


@given(speed=st.floats(0.1, 0.8), x=st.floats(0.5, 20.0))
def test_a_goal_is_as_far_as_the_speed_leads_until_the_last_two_seconds(make_goals, speed, x):
    assert make_goals(track(speed), x=x).goal_w[0, 0].item() == pytest.approx(x + 8.0 * speed, abs=1e-5)


def test_the_last_goal_is_at_the_end_of_the_course(make_goals):
    assert make_goals(track(), x=32.0).goal_w.tolist() == [[LENGTH - 1.0, 0.0]]


def test_on_a_course_the_next_goal_comes_before_the_robot_stops(make_goals):
    goals = make_goals(track(), x=0.0)
    walk(goals, to=(3.4, 0.1), seconds=6.0)
    assert goals.goal_w.tolist() == [[4.0, 0.0]]
    assert goals.elapsed_s.item() == pytest.approx(6.0)
    walk(goals, to=(3.6, 0.1), seconds=0.4)  # less than PASSED away
    assert PASSED == 0.5
    assert goals.goal_w[0].tolist() == pytest.approx([7.6, 0.0])
    assert (goals.elapsed_s.item(), goals.left_s.item()) == (0.0, 10.0)
    assert goals.moving.all()


def test_a_goal_whose_time_is_over_makes_room_for_one_ahead_of_where_the_robot_is(make_goals):
    goals = make_goals(track(), x=1.0)
    walk(goals, to=(1.5, 0.0), seconds=9.98)
    assert goals.goal_w.tolist() == [[5.0, 0.0]]
    walk(goals, to=(1.6, 0.0))
    assert goals.goal_w[0].tolist() == pytest.approx([5.6, 0.0])
    assert goals.elapsed_s.item() == 0.0


def test_on_a_course_the_velocity_is_what_every_other_method_is_asked_for(make_goals):
    cfg = track()
    goals = make_goals(cfg, x=2.0, y=0.4, heading=0.2)
    expected = max(-0.2, min(0.2, 0.5 * (-0.6 * 0.4 - 0.2)))
    assert goals.velocity[0].tolist() == pytest.approx([0.5, 0.0, expected])


def test_in_training_a_robot_stays_at_its_goal_until_the_time_is_over(make_goals):
    goals = make_goals(x=1.0)
    assert GoalCommandCfg().pass_at == 0.0
    walk(goals, to=(4.9, 0.0), seconds=7.0)
    assert goals.reached.all()
    assert not goals.moving.any()
    assert goals.velocity.count_nonzero() == 0
    assert goals.goal_w.tolist() == [[5.0, 0.0]]
    walk(goals, seconds=3.0)
    assert goals.goal_w[0].tolist() == pytest.approx([8.9, 0.0])
    assert goals.moving.all()
    assert goals.velocity[0, 0] == 0.5


def test_a_goal_is_reached_within_twenty_centimetres(make_goals):
    goals = make_goals(x=1.0)
    for x, reached in ((4.79, False), (4.81, True), (5.19, True), (5.21, False)):
        walk(goals, to=(x, 0.0))
        assert goals.reached.tolist() == [reached]


def test_on_tiles_walked_in_any_direction_goals_lie_all_around_and_never_close_to_the_edge(make_goals):
    goals = make_goals(num_envs=2000, x=5.0, free=True, length=10.0, width=8.0)
    way = goals.to_goal_w
    assert way.norm(dim=1).max() <= 4.0 + 1e-5
    for sign in (-1.0, 1.0):
        assert ((sign * way) > 2.0).float().mean(dim=0).min() > 0.2
    assert goals.goal_w[:, 0].min() >= 1.0 - 1e-6
    assert goals.goal_w[:, 0].max() <= 9.0 + 1e-6
    assert goals.goal_w[:, 1].abs().max() <= 3.0 + 1e-6


@settings(max_examples=12)
@given(heading=st.floats(-3.1, 3.1))
def test_there_the_velocity_points_to_the_goal_in_the_robots_own_frame(make_goals, heading):
    goals = make_goals(num_envs=8, x=5.0, heading=heading, free=True, length=10.0, width=8.0)
    way = goals.to_goal_w
    for i in range(8):
        off = math.remainder(math.atan2(way[i, 1], way[i, 0]) - heading, 2.0 * math.pi)
        expected = [0.5 * math.cos(off), 0.5 * math.sin(off), max(-0.3, min(0.3, 0.5 * off))]
        assert goals.velocity[i].tolist() == pytest.approx(expected, abs=1e-5)


def test_a_reset_sets_goals_for_the_envs_in_question_alone(make_goals):
    goals = make_goals(num_envs=2, x=1.0)
    goals._env.steps_since_reset = torch.tensor([100, 100])
    goals.step()
    goals._env.signals.root_pos_w = torch.tensor([[2.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    goals.reset(torch.tensor([True, False]))
    goals._env.steps_since_reset = torch.tensor([0, 100])
    assert goals.goal_w.tolist() == [[6.0, 0.0], [5.0, 0.0]]
    assert goals.elapsed_s.tolist() == pytest.approx([0.0, 2.0])


def test_who_is_asked_to_stand_has_its_goal_where_it_is(make_goals):
    cfg = GoalCommandCfg().on_course(VelocityCommandCfg(standing_share=1.0, heading_share=0.0))
    goals = make_goals(cfg, x=3.0, y=0.5)
    assert goals.goal_w.tolist() == [[3.0, 0.5]]
    assert goals.velocity.count_nonzero() == 0


def test_beside_and_behind_are_goals_too(make_goals):
    asked = VelocityCommandCfg(
        speed=(-0.2, -0.2), lateral=(0.1, 0.1), lateral_gain=0.0, heading_share=1.0, standing_share=0.0
    )
    goals = make_goals(GoalCommandCfg().on_course(asked), x=10.0, y=0.5)
    assert goals.goal_w[0].tolist() == pytest.approx([8.4, 1.3])


@pytest.mark.parametrize(
    ("cfg", "said"),
    [
        (GoalCommandCfg(heading_share=0.5), "cannot ask for a yaw rate, so it must be 1"),
        (GoalCommandCfg(stay_s=10.0), "stay_s 10 must be less than time_s 10"),
        (GoalCommandCfg(edge=3.0), "edge 3 leaves no room for goals on a tile of 35 x 6 m"),
        (GoalCommandCfg(modes={"forward": 1.0}), "goals have no modes"),
        (GoalCommandCfg(reach=0.0), r"command.reach is 0; it must be positive"),
    ],
)
def test_what_goals_cannot_do_is_refused(make_goals, cfg, said):
    with pytest.raises(UserError, match=said):
        make_goals(cfg)


def test_other_tasks_get_the_velocity_that_an_evaluation_asks_for():
    asked = VelocityCommandCfg(speed=(0.5, 0.5))
    assert VelocityCommandCfg().on_course(asked) is asked
