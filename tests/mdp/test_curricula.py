"""Envs move to steeper and to gentler tiles."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.mdp.curricula import TerrainLevels
from humoslope.mdp.harness import Harness
from humoslope.scene.tiles import Tiles
from humoslope.terrain.grid import Terrain

N, LEVELS, LENGTH, SPAWN = 6, 5, 10.0, 0.75
REACH = LENGTH - SPAWN


@pytest.fixture(scope="module")
def make_ground(make_env, g1):
    """make_ground(): envs on two columns of tiles that get steeper."""

    def make(omnidirectional=frozenset()):
        origins = np.zeros((LEVELS, 2, 3))
        origins[:, :, 0] = 10.1 * np.arange(LEVELS)[:, None] - 25.0
        origins[:, :, 1] = [-2.5, 2.5]
        terrain = Terrain(
            heights=np.zeros((round((10.1 * LEVELS + LENGTH)), 11), dtype=np.float32),
            cell=1.0,
            origin=(-25.0, -5.0),
            tile_origin=origins,
            kind=("ramp-up", "ramp-down"),
            grade=np.linspace(0.0, 32.0, LEVELS)[:, None].repeat(2, axis=1),
            tile_length=LENGTH,
            tile_width=5.0,
            spawn_x=SPAWN,
            omnidirectional=omnidirectional,
        )
        return make_env(
            N,
            tiles=Tiles(terrain, N, torch.device("cpu")),
            commands=SimpleNamespace(velocity=torch.zeros(N, 3)),
            terminations=SimpleNamespace(terminated=torch.zeros(N, dtype=torch.bool)),
            diverged=torch.zeros(N, dtype=torch.bool),
            robot=SimpleNamespace(total_mass=33.0, root_body="pelvis", torso_body="torso_link"),
            body_id=lambda name: g1.body(name).id,
            sim=SimpleNamespace(model=g1, state=lambda field: torch.zeros(N, g1.nbody, 6)),
        )

    return make


@pytest.fixture
def env(make_ground):
    return make_ground()


def walk(env, term, covered, commanded=0.0, walked=None, start=0.0):
    """Envs at the end of an episode that began `start` m beyond the spawn place.

    Args:
        covered: Distance along the tile, m.
        commanded: Distance that was commanded, m.
        walked: Distance in the commanded direction, m; the same as `covered` by default.
    """
    x = env.tiles.origin_w[:, 0] + SPAWN + torch.as_tensor(start)
    env.start_root_pos_w = torch.stack([x, torch.zeros(N), torch.zeros(N)], dim=1)
    env.signals = SimpleNamespace(root_pos_w=env.start_root_pos_w + torch.as_tensor(covered).reshape(-1, 1) * ALONG)
    follow(env, term, commanded, covered if walked is None else walked)


def follow(env, term, commanded, walked, direction=(1.0, 0.0)):
    """A step in which so much, m, was commanded and walked in that direction."""
    unit = torch.tensor([[*direction, 0.0]]) / env.step_dt
    env.commands.velocity = torch.as_tensor(commanded).reshape(-1, 1).expand(N, 1) * unit
    env.signals.root_lin_vel_t = torch.as_tensor(walked).reshape(-1, 1).expand(N, 1) * unit
    term.step(env)


def end(env, term, mask):
    term.reset(mask)
    return env.tiles.level.tolist()


def begin(env, level):
    env.tiles.set_level(torch.full((N,), level))


ALONG = torch.tensor([[1.0, 0.0, 0.0]])
EVERYWHERE = torch.ones(N, dtype=torch.bool)


@pytest.mark.parametrize(
    ("covered", "commanded", "level"),
    [
        (0.51 * REACH, 9.0, 3),  # more than half of the tile
        (0.49 * REACH, 9.0, 2),  # not quite
        (0.26 * 9.0, 9.0, 2),
        (0.24 * 9.0, 9.0, 1),  # little of the command
        (0.5, 1.0, 2),  # half of the little that was commanded
        (0.24, 1.0, 1),
        (0.0, 0.99, 2),  # too little was commanded to judge by
        (-0.1, 0.0, 2),  # pushed back while commanded to stand
        (0.1, 0.0, 2),
    ],
)
def test_an_env_moves_up_after_half_of_its_tile_and_down_after_little_of_its_command(env, covered, commanded, level):
    term = TerrainLevels(env)
    begin(env, 2)
    walk(env, term, covered, commanded)
    assert end(env, term, EVERYWHERE) == [level] * N


@pytest.mark.parametrize("start", [-0.15, 0.15, 2.0])
@pytest.mark.parametrize(("share", "level"), [(0.49, 2), (0.51, 3)])
def test_what_is_covered_counts_from_where_the_robot_was_put(env, start, share, level):
    term = TerrainLevels(env)
    begin(env, 2)
    walk(env, term, share * (REACH - start), start=start)
    assert end(env, term, EVERYWHERE) == [level] * N


@given(angle=st.floats(-math.pi, math.pi), share=st.floats(0.0, 1.0))
def test_a_command_in_any_direction_is_judged_by_what_was_walked_in_it(make_ground, angle, share):
    assume(abs(share - 0.25) > 1e-3)
    env = make_ground()
    term = TerrainLevels(env)
    begin(env, 2)
    walk(env, term, 0.0)
    for part in (0.5, 1.5, 3.0):  # a turn in between: the directions do not cancel
        angle = -angle
        follow(env, term, part, share * part, (math.cos(angle), math.sin(angle)))
    assert end(env, term, EVERYWHERE) == [2 if share > 0.25 else 1] * N


def test_on_a_slope_the_distance_counts_along_the_ground_as_it_was_commanded(env):
    """2.6 of 10 m along the ground at 32 degrees are 2.2 m on the map."""
    term = TerrainLevels(env)
    begin(env, 4)
    walk(env, term, 2.6 * math.cos(math.radians(32.0)), commanded=10.0, walked=2.6)
    assert end(env, term, EVERYWHERE) == [4] * N


def test_the_least_commanded_distance_is_a_parameter(env):
    term = TerrainLevels(env, least_commanded=5.0)
    begin(env, 2)
    walk(env, term, 0.0, torch.tensor([4.9, 5.1, 4.9, 5.1, 4.9, 5.1]))
    assert end(env, term, EVERYWHERE) == [2, 1, 2, 1, 2, 1]


def test_a_fall_costs_a_level_unless_half_of_the_tile_was_covered(env):
    term = TerrainLevels(env)
    begin(env, 2)
    walk(env, term, torch.tensor([4.0, 4.0, 4.0, 8.0, 8.0, 8.0]), 4.0)
    env.terminations.terminated = torch.tensor([True, False, False, True, False, False])
    assert end(env, term, EVERYWHERE) == [1, 2, 2, 3, 3, 3]


def test_only_envs_whose_episode_ends_move(env, mask):
    term = TerrainLevels(env)
    begin(env, 2)
    walk(env, term, 9.0)
    assert end(env, term, mask(N, 0, 5)) == [3, 2, 2, 2, 2, 3]


def test_the_place_of_a_diverged_env_says_nothing_of_its_level(env, mask):
    term = TerrainLevels(env)
    begin(env, 2)
    walk(env, term, torch.tensor([40.0, -40.0, 9.0, 9.0, 9.0, 9.0]), 5.0)
    env.diverged = mask(N, 0, 1)
    assert end(env, term, EVERYWHERE) == [2, 2, 3, 3, 3, 3]


def test_there_is_nothing_below_the_easiest_level(env):
    term = TerrainLevels(env)
    env.terminations.terminated = EVERYWHERE
    walk(env, term, 1.0, 5.0)
    assert end(env, term, EVERYWHERE) == [0] * N


def test_from_the_hardest_level_an_env_goes_to_any(env):
    term, seen = TerrainLevels(env), set()
    for _ in range(40):
        begin(env, LEVELS - 1)
        walk(env, term, 9.0)
        seen.update(end(env, term, EVERYWHERE))
    assert seen == set(range(LEVELS))


def test_the_command_adds_up_over_the_episode_and_is_forgotten_with_it(env, mask):
    term = TerrainLevels(env)
    begin(env, 2)
    for _ in range(4):
        walk(env, term, 0.0, commanded=1.0)
    assert end(env, term, mask(N, 1)) == [2, 1, 2, 2, 2, 2]
    walk(env, term, 0.3, commanded=0.0)  # in all 0.3 of 4 m, but of none in env 1
    assert end(env, term, EVERYWHERE) == [1, 1, 1, 1, 1, 1]
    walk(env, term, 4.0, commanded=9.0)
    assert end(env, term, EVERYWHERE) == [1] * N
    walk(env, term, 0.0, commanded=9.0)  # what was walked is forgotten too
    assert end(env, term, EVERYWHERE) == [0] * N


@pytest.mark.parametrize(("strictness", "highest"), [(0.0, 0), (0.19, 0), (0.21, 1), (0.5, 2), (0.9, 4), (1.0, 4)])
def test_levels_open_as_the_strictness_of_the_harness_grows(env, strictness, highest):
    env.events = {"carrier": Harness(env, scale=0.0)}
    env.events["carrier"].strictness = torch.tensor(strictness)
    term = TerrainLevels(env, harness="carrier")
    for _ in range(10):
        if (env.tiles.level == LEVELS - 1).all():
            break
        walk(env, term, 9.0)
        term.reset(EVERYWHERE)
    assert env.tiles.level.tolist() == [highest] * N


def test_only_a_harness_opens_levels(env):
    env.events = {"push": lambda env, mask: None}
    with pytest.raises(UserError, match="event 'push' is not a Harness"):
        TerrainLevels(env, harness="push")


def test_an_env_knows_the_place_and_the_grade_of_its_tile(env):
    begin(env, 3)
    assert env.tiles.column.tolist() == [0, 0, 0, 1, 1, 1]
    torch.testing.assert_close(env.tiles.origin_w[0], torch.tensor([10.1 * 3 - 25.0, -2.5, 0.0]))
    torch.testing.assert_close(env.tiles.origin_w[5], torch.tensor([10.1 * 3 - 25.0, 2.5, 0.0]))
    torch.testing.assert_close(torch.rad2deg(env.tiles.grade), torch.full((N,), 24.0))


@pytest.mark.parametrize(("up", "down"), [(0.4, 0.8), (0.5, 0.5), (1.2, 0.4), (0.8, 0.0)])
def test_shares_that_contradict_each_other_are_refused(env, up, down):
    with pytest.raises(UserError, match="must be shares with 0 < down < up <= 1"):
        TerrainLevels(env, up=up, down=down)


@pytest.mark.parametrize(("spread", "levels"), [(0.0, 1), (0.4, 2), (1.0, LEVELS)])
def test_envs_may_start_spread_over_the_levels(env, spread, levels):
    seen = set()
    for _ in range(30):
        TerrainLevels(env, spread=spread)
        seen |= set(env.tiles.level.tolist())
    assert seen == set(range(levels))


def test_a_spread_that_is_no_share_is_refused(env):
    with pytest.raises(UserError, match="spread 1.5 must be between 0 and 1"):
        TerrainLevels(env, spread=1.5)


@pytest.mark.parametrize("least", [-1.0, math.nan, math.inf])
def test_a_least_distance_that_is_none_is_refused(env, least):
    with pytest.raises(UserError, match="terrain levels: least_commanded is .*; it must be 0 or more"):
        TerrainLevels(env, least_commanded=least)


# Tiles that are walked in any direction


@given(
    angle=st.floats(-math.pi, math.pi),
    share=st.floats(0.0, 1.2),
    commanded=st.floats(0.0, 9.0),
    seconds=st.floats(0.5, 20.0),
    fallen=st.booleans(),
)
def test_on_a_hillside_a_level_is_earned_by_some_seconds_of_following(
    make_ground, angle, share, commanded, seconds, fallen
):
    assume(min(abs(share - 0.5), abs(share - 0.25), abs(commanded - 1.0)) > 1e-3 and commanded > 1e-3)
    env = make_ground(frozenset({0, 1}))
    term = TerrainLevels(env)
    begin(env, 2)
    walk(env, term, 0.0)
    steps = round(seconds / env.step_dt)
    env.steps_since_reset = torch.full((N,), steps)
    env.terminations.terminated = torch.full((N,), fallen)
    for part in (0.3, 0.7):
        angle = -angle
        follow(env, term, part * commanded, share * part * commanded, (math.cos(angle), math.sin(angle)))
    late, lazy = steps * env.step_dt > 4.999, share < 0.25 and commanded > 1.0
    up = late and share > 0.5 and not fallen
    down = (fallen and not late) or lazy
    assert end(env, term, EVERYWHERE) == [3 if up else 1 if down else 2] * N


def test_the_way_along_x_earns_nothing_on_a_hillside_and_all_on_a_tile_walked_along_x(make_ground):
    env = make_ground(frozenset({1}))  # the column of the last three envs
    term = TerrainLevels(env)
    begin(env, 2)
    env.steps_since_reset = torch.full((N,), 500)
    walk(env, term, 0.9 * REACH, commanded=9.0, walked=0.4 * 9.0)
    assert end(env, term, EVERYWHERE) == [3, 3, 3, 2, 2, 2]


def test_a_late_fall_costs_a_level_on_a_tile_walked_along_x_and_none_on_a_hillside(make_ground):
    env = make_ground(frozenset({1}))
    term = TerrainLevels(env)
    begin(env, 2)
    env.steps_since_reset = torch.full((N,), 500)
    env.terminations.terminated = EVERYWHERE
    walk(env, term, 0.3 * REACH, commanded=9.0, walked=0.4 * 9.0)
    assert end(env, term, EVERYWHERE) == [1, 1, 1, 2, 2, 2]


@pytest.mark.parametrize(
    ("seconds", "fallen", "level"), [(4.9, False, 2), (5.1, False, 3), (4.9, True, 1), (5.1, True, 2)]
)
def test_who_stands_on_a_hillside_as_commanded_earns_a_level_by_not_falling(make_ground, seconds, fallen, level):
    env = make_ground(frozenset({0, 1}))
    term = TerrainLevels(env)
    begin(env, 2)
    env.steps_since_reset = torch.full((N,), round(seconds / env.step_dt))
    env.terminations.terminated = torch.full((N,), fallen)
    walk(env, term, 0.0)
    assert end(env, term, EVERYWHERE) == [level] * N


@pytest.mark.parametrize("seconds", [0.0, -1.0, math.nan])
def test_a_level_must_be_earned_over_some_time(env, seconds):
    with pytest.raises(UserError, match="terrain levels: least_s is .*; it must be positive"):
        TerrainLevels(env, least_s=seconds)
