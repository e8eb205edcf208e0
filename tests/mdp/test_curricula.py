"""Worlds move to steeper and to gentler tiles."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from humoslope.errors import UserError
from humoslope.mdp.curricula import TerrainLevels
from humoslope.scene.tiles import Tiles
from humoslope.terrain.grid import Terrain

N, LEVELS, LENGTH, SPAWN = 6, 5, 10.0, 0.75
REACH = LENGTH - SPAWN


@pytest.fixture
def env(make_env):
    origins = np.zeros((LEVELS, 2, 3))
    origins[:, :, 0] = 10.1 * np.arange(LEVELS)[:, None] - 25.0
    origins[:, :, 1] = [-2.5, 2.5]
    terrain = Terrain(
        heights=np.zeros((2, 2), dtype=np.float32),
        cell=0.1,
        origin=(0.0, 0.0),
        tile_origin=origins,
        kind=("ramp-up", "ramp-down"),
        grade=np.linspace(0.0, 32.0, LEVELS)[:, None].repeat(2, axis=1),
        tile_length=LENGTH,
        tile_width=5.0,
        spawn_x=SPAWN,
    )
    return make_env(
        N,
        tiles=Tiles(terrain, N, torch.device("cpu")),
        commands=SimpleNamespace(velocity=torch.zeros(N, 3)),
        terminations=SimpleNamespace(terminated=torch.zeros(N, dtype=torch.bool)),
        diverged=torch.zeros(N, dtype=torch.bool),
        curriculum={"harness": SimpleNamespace(scale=torch.tensor(1.0))},
    )


def walk(env, term, covered, asked=0.0, heading=0.0):
    """Worlds that have covered and were asked for so much since their spawn place, in m, as their episodes end."""
    x = env.tiles.origin_w[:, 0] + SPAWN + torch.as_tensor(covered)
    env.signals = SimpleNamespace(
        root_pos_w=torch.stack([x, torch.zeros(N), torch.zeros(N)], dim=1), heading_w=torch.full((N,), heading)
    )
    env.commands.velocity[:, 0] = torch.as_tensor(asked) / env.step_dt  # all of it in the last step


def start(env, level):
    env.tiles.set_level(torch.full((N,), level))


EVERYWHERE = torch.ones(N, dtype=torch.bool)


def test_what_is_asked_adds_up_in_steps_in_which_nobody_is_known_to_end(env):
    env.sim = SimpleNamespace(known_empty=lambda mask: not mask.any())
    term = TerrainLevels(env)
    start(env, 2)
    walk(env, term, 2.0, 4.0)
    term(env, ~EVERYWHERE)
    walk(env, term, 2.0, 4.0)
    assert (term(env, EVERYWHERE) == 1).all()  # 2 m of 8, not of 4


@pytest.mark.parametrize(
    ("covered", "asked", "level"),
    [
        (0.81 * REACH, 9.0, 3),  # most of the tile
        (0.79 * REACH, 9.0, 2),  # not quite
        (0.41 * 9.0, 9.0, 2),
        (0.39 * 9.0, 9.0, 1),  # little of what was asked
        (0.5, 1.0, 2),  # half of the little that was asked
        (-0.1, 0.0, 1),  # pushed back while asked to stand
        (0.1, 0.0, 2),
    ],
)
def test_a_world_moves_up_after_most_of_its_tile_and_down_after_little_of_what_was_asked(env, covered, asked, level):
    term = TerrainLevels(env)
    start(env, 2)
    walk(env, term, covered, asked)
    assert term(env, EVERYWHERE).tolist() == [level] * N


def test_a_fall_costs_a_level_unless_most_of_the_tile_was_covered(env):
    term = TerrainLevels(env)
    start(env, 2)
    walk(env, term, torch.tensor([4.0, 4.0, 4.0, 8.0, 8.0, 8.0]), 4.0)
    env.terminations.terminated = torch.tensor([True, False, False, True, False, False])
    assert term(env, EVERYWHERE).tolist() == [1, 2, 2, 3, 3, 3]


def test_only_worlds_whose_episode_ends_move(env, mask):
    term = TerrainLevels(env)
    start(env, 2)
    walk(env, term, 9.0)
    assert term(env, mask(N, 0, 5)).tolist() == [3, 2, 2, 2, 2, 3]


def test_where_a_diverged_world_ended_up_says_nothing_of_its_level(env, mask):
    term = TerrainLevels(env)
    start(env, 2)
    walk(env, term, torch.tensor([40.0, -40.0, 9.0, 9.0, 9.0, 9.0]))
    env.diverged = mask(N, 0, 1)
    assert term(env, EVERYWHERE).tolist() == [2, 2, 3, 3, 3, 3]


def test_there_is_nothing_below_the_easiest_level(env):
    term = TerrainLevels(env)
    env.terminations.terminated = EVERYWHERE
    walk(env, term, 1.0, 5.0)
    assert term(env, EVERYWHERE).tolist() == [0] * N


def test_from_the_hardest_level_a_world_goes_to_any(env):
    term, seen = TerrainLevels(env), set()
    for _ in range(40):
        start(env, LEVELS - 1)
        walk(env, term, 9.0)
        seen.update(term(env, EVERYWHERE).tolist())
    assert seen == set(range(LEVELS))


def test_who_is_asked_to_turn_away_is_not_asked_to_cover_the_tile(env):
    term = TerrainLevels(env)
    start(env, 2)
    walk(env, term, 0.5, asked=9.0, heading=1.5)
    assert term(env, EVERYWHERE).tolist() == [2] * N


def test_what_was_asked_adds_up_over_the_episode_and_is_forgotten_with_it(env, mask):
    term = TerrainLevels(env)
    start(env, 2)
    for _ in range(4):
        walk(env, term, 1.0, asked=1.0)
        term(env, mask(N))
    walk(env, term, 1.5, asked=0.0)  # 1.5 of 4 m
    term.reset(mask(N, 1))
    assert term(env, EVERYWHERE).tolist() == [1, 2, 1, 1, 1, 1]


@pytest.mark.parametrize(("scale", "highest"), [(1.0, 0), (0.81, 0), (0.79, 1), (0.5, 2), (0.1, 4), (0.0, 4)])
def test_levels_open_as_the_harness_is_withdrawn(env, scale, highest):
    term = TerrainLevels(env, harness="harness")
    env.curriculum["harness"].scale = torch.tensor(scale)
    for _ in range(10):
        if (env.tiles.level == LEVELS - 1).all():
            break
        walk(env, term, 9.0)
        term(env, EVERYWHERE)
    assert env.tiles.level.tolist() == [highest] * N


def test_a_world_knows_the_place_and_the_grade_of_its_tile(env):
    start(env, 3)
    assert env.tiles.column.tolist() == [0, 0, 0, 1, 1, 1]
    torch.testing.assert_close(env.tiles.origin_w[0], torch.tensor([10.1 * 3 - 25.0, -2.5, 0.0]))
    torch.testing.assert_close(env.tiles.origin_w[5], torch.tensor([10.1 * 3 - 25.0, 2.5, 0.0]))
    torch.testing.assert_close(torch.rad2deg(env.tiles.grade), torch.full((N,), 24.0))


@pytest.mark.parametrize(("up", "down"), [(0.4, 0.8), (0.5, 0.5), (1.2, 0.4), (0.8, 0.0)])
def test_shares_that_contradict_each_other_are_refused(env, up, down):
    with pytest.raises(UserError, match="must be shares with 0 < down < up <= 1"):
        TerrainLevels(env, up=up, down=down)


@pytest.mark.parametrize(("spread", "levels"), [(0.0, 1), (0.4, 2), (1.0, LEVELS)])
def test_worlds_may_start_spread_over_the_levels(env, spread, levels):
    seen = set()
    for _ in range(30):
        TerrainLevels(env, spread=spread)
        seen |= set(env.tiles.level.tolist())
    assert seen == set(range(levels))


def test_a_spread_that_is_no_share_is_refused(env):
    with pytest.raises(UserError, match="spread 1.5 must be between 0 and 1"):
        TerrainLevels(env, spread=1.5)
