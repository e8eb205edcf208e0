"""Why episodes end."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch
from scipy.spatial.transform import Rotation

from humoslope.mdp import terminations


def test_an_episode_ends_with_its_last_step(make_env):
    env = make_env(3, episode_length_buf=torch.tensor([998, 999, 1000]), max_episode_length=999)
    assert terminations.time_out(env).tolist() == [False, True, True]


def test_a_root_is_too_low_over_the_ground_below_it_not_over_the_world(make_env, pose):
    high_on_the_slope = pose(30.0, root_pos_w=[2.0, 0.0, 1.5]).signals  # the ground is at 1.15 m
    low_in_the_valley = pose(30.0, root_pos_w=[-2.0, 0.0, -0.5]).signals  # the ground is at -1.15 m
    assert terminations.root_too_low(make_env(1, signals=high_on_the_slope), height=0.4).item()
    assert not terminations.root_too_low(make_env(1, signals=low_in_the_valley), height=0.4).item()


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize(("angle", "down"), [(0.0, False), (54.0, False), (-54.0, False), (56.0, True), (170.0, True)])
def test_a_robot_is_tilted_beyond_its_angle_in_any_direction(make_env, pose, axis, angle, down):
    quat = Rotation.from_euler("Z" + axis.upper(), [70.0, angle], degrees=True).as_quat(scalar_first=True)
    env = make_env(1, signals=pose(root_quat_w=quat).signals)
    assert terminations.tilted(env, degrees=55.0).item() is down


@pytest.mark.parametrize(
    ("x", "y", "off"),
    [
        (5.0, 0.0, False),
        (0.31, 2.19, False),
        (9.69, -2.19, False),
        (0.29, 0.0, True),
        (9.71, 0.0, True),
        (5.0, 2.21, True),
        (5.0, -2.21, True),
    ],
)
def test_a_robot_is_off_its_tile_within_the_margin_of_its_edge(make_env, x, y, off):
    assert terminations.off_tile(on_tile(make_env, x, y, free=False), margin=0.3).item() is off


@pytest.mark.parametrize(
    ("x", "y", "off"),
    [
        (5.0, 0.0, False),
        (0.61, 1.89, False),
        (9.39, -1.89, False),
        (0.59, 0.0, True),
        (9.41, 0.0, True),
        (5.0, 1.91, True),
        (5.0, -1.91, True),
    ],
)
def test_on_a_hillside_the_margin_is_wider_on_all_four_sides(make_env, x, y, off):
    env = on_tile(make_env, x, y, free=True)
    assert terminations.off_tile(env, margin=0.3).item() is off
    assert terminations.off_tile(env, margin=9.0, omnidirectional_margin=0.1).item() is False


def on_tile(make_env, x, y, free):
    tiles = SimpleNamespace(
        origin_w=torch.tensor([[-20.0, 7.0, 0.0]]),
        length=10.0,
        width=5.0,
        omnidirectional=torch.tensor([free]),
        has_omnidirectional=free,
    )
    return make_env(1, tiles=tiles, signals=SimpleNamespace(root_pos_w=torch.tensor([[-20.0 + x, 7.0 + y, 3.0]])))
