"""Voxel columns as a slow, late and faulty sensor reports them."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
import torch

from humoslope.errors import UserError
from humoslope.managers import ObservationGroupCfg, ObservationTermCfg, Terms
from humoslope.mdp import voxels
from humoslope.mdp.voxels import VoxelColumns, grid_of
from humoslope.scene.bodies import Bodies
from humoslope.scene.tiles import Tiles
from humoslope.slope import quaternion
from humoslope.terrain import TerrainQueries
from robots.unitree_g1 import UNITREE_G1
from tests.mdp.conftest import plane

TILES = SimpleNamespace(width=6.0, length=6.0)


def uniform(env, frame):
    return torch.rand_like(frame)


@pytest.fixture
def make_term(make_env, monkeypatch):
    """A sensor whose frames hold the control step at which they were taken, from 0 on, and its environment."""

    def make(num_envs: int = 4, noisy: bool = False, scan: float | None = None, **params: object):
        env = make_env(num_envs, tiles=TILES, steps_since_reset=torch.zeros(num_envs, dtype=torch.int64))
        term = VoxelColumns(env, cell=0.1, **params)
        term.noise_source = uniform if noisy else None

        def taken(env, rows=slice(None)):
            value = env.steps_since_reset[rows].float() if scan is None else torch.full((num_envs,), scan)
            return value[:, None].repeat(1, 256)

        monkeypatch.setattr(term, "scan", taken)
        return term, env

    return make


def test_what_is_seen_is_ten_to_fourteen_steps_old_without_noise(make_term):
    term, env = make_term(1)
    seen = []
    for step in range(30):
        env.steps_since_reset = torch.tensor([step])
        seen.append(int(term(env)[0, 0]))
    # A frame every five steps, seen two frames late; before that the first one of the episode.
    assert seen == [0] * 15 + [5] * 5 + [10] * 5 + [15] * 5
    ages = [step - taken for step, taken in enumerate(seen)][15:]
    assert (min(ages), max(ages)) == (10, 14)


def test_the_longest_lag_is_a_frame_more(make_term):
    term, env = make_term(1)
    term._frames.lag.fill_(3)
    seen = []
    for step in range(30):
        env.steps_since_reset = torch.tensor([step])
        seen.append(int(term(env)[0, 0]))
    assert seen == [0] * 20 + [5] * 5 + [10] * 5


def test_an_episode_begins_with_its_first_frame_and_leaves_the_other_envs_alone(make_term):
    term, env = make_term(2)
    for step in range(20):
        env.steps_since_reset = torch.tensor([step, step])
        term(env)
    env.steps_since_reset = torch.tensor([0, 20])
    assert term(env)[:, 0].tolist() == [0.0, 10.0]
    for step in range(1, 17):
        env.steps_since_reset = torch.tensor([step, 20 + step])
        seen = term(env)
    assert seen[:, 0].tolist() == [5.0, 25.0]


def test_the_lag_is_two_frames_in_five_episodes_of_nine_and_else_three(make_term):
    term, env = make_term(4000, noisy=True, scan=0.0)
    term(env)
    lag = term._frames.lag
    assert set(lag.tolist()) == {2, 3}
    assert (lag == 2).float().mean().item() == pytest.approx(5 / 9, abs=0.032)  # four deviations
    before = lag.clone()
    env.steps_since_reset = env.steps_since_reset + 5
    term(env)
    assert term._frames.lag.equal(before)  # drawn once in an episode


def test_two_percent_of_the_columns_are_empty_and_the_others_have_a_centimetre_of_noise(make_term):
    term, env = make_term(400, noisy=True, scan=-0.8)
    heights = term(env)
    empty = heights == term.grid.empty
    assert empty.float().mean().item() == pytest.approx(0.02, abs=4.0 * math.sqrt(0.02 * 0.98 / heights.numel()))
    error = heights[~empty] + 0.8
    assert error.mean().item() == pytest.approx(0.0, abs=2e-4)
    assert error.std().item() == pytest.approx(0.01, rel=0.02)
    assert error.abs().max() < 0.051
    beyond_two = (error.abs() > 0.02).float().mean().item()
    assert beyond_two == pytest.approx(0.0455, abs=0.004)  # as normally distributed numbers


def test_every_frame_has_holes_of_its_own(make_term):
    term, env = make_term(50, noisy=True, scan=-0.8)
    first = term(env) == term.grid.empty
    for step in (5, 10, 15, 20):
        env.steps_since_reset = torch.full((50,), step)
        later = term(env) == term.grid.empty
    assert 0.0 < (first & later).float().mean() < 0.25 * first.float().mean()


def test_the_torso_pose_has_one_error_for_an_episode(make_term):
    term, env = make_term(5000, noisy=True, scan=-0.8)
    term(env)
    assert term._position.std().item() == pytest.approx(0.005, rel=0.03)
    assert term._turn.std().item() == pytest.approx(math.radians(1.0), rel=0.03)
    before = term._turn.clone()
    env.steps_since_reset = torch.where(torch.arange(5000) < 10, 0, 5)
    term(env)
    same = (term._turn == before).all(dim=1)
    assert not same[:10].any()
    assert same[10:].all()


def test_nothing_of_it_is_left_without_noise(make_term):
    term, env = make_term(50, scan=-0.8)
    assert (term(env) == -0.8).all()
    assert (term._frames.lag == 2).all()
    assert term._turn.count_nonzero() == 0


def test_extreme_random_numbers_stay_finite():
    edges = torch.tensor([0.0, 2.0**-24, 0.5, 1.0 - 2.0**-24])
    drawn = voxels._normal(edges)
    assert drawn.isfinite().all()
    assert drawn[2] == 0.0
    assert drawn[0] == -voxels.LARGEST_DEVIATION


def standing(make_env, pos=(0.0, 0.0, 0.8), quat=(1.0, 0.0, 0.0, 0.0), slope=0.0, uphill=0.0):
    """A robot whose torso has this pose, in the middle of a slope."""
    terrain = plane(slope, uphill)
    queries = TerrainQueries(terrain, "cpu")
    torso = torch.tensor([pos])
    around = queries.height(queries.around(torso[:, :2]))
    signals = SimpleNamespace(torso_quat_w=torch.tensor([quat]), slope_normal_w=queries.slope_normal(around))
    env = make_env(
        1,
        tiles=Tiles(terrain, 1, torch.device("cpu")),
        signals=signals,
        terrain=queries,
        robot=UNITREE_G1,
        bodies=SimpleNamespace(position=lambda name: {"torso_link": torso}[name]),
        steps_since_reset=torch.zeros(1, dtype=torch.int64),
    )
    return VoxelColumns(env, cell=0.1), env


def test_the_ground_is_as_far_below_the_torso_as_the_torso_is_above_it(make_env):
    term, env = standing(make_env)
    assert term(env).tolist()[0] == pytest.approx([-0.8] * 256, abs=1e-6)


@pytest.mark.parametrize("yaw", [0.0, 90.0, 180.0])
def test_columns_turn_with_the_torso(make_env, yaw):
    turn = quaternion.from_yaw(torch.tensor(math.radians(yaw))).tolist()
    term, env = standing(make_env, quat=turn, slope=20.0)
    heights = term(env)[0].view(16, 16) + 0.8
    ahead, left = heights[15].mean().item(), heights[:, 15].mean().item()
    rise = 0.75 * math.tan(math.radians(20.0))
    assert ahead == pytest.approx(rise * math.cos(math.radians(yaw)), abs=1e-5)
    assert left == pytest.approx(-rise * math.sin(math.radians(yaw)), abs=1e-5)


def test_a_torso_that_leans_forward_has_the_ground_ahead_higher_in_its_own_frame(make_env):
    lean = math.radians(10.0)
    quat = (math.cos(0.5 * lean), 0.0, math.sin(0.5 * lean), 0.0)
    term, env = standing(make_env, quat=quat)
    heights = term(env)[0].view(16, 16)
    # The line along the torso's up axis from a place x ahead meets the ground at -(h - x sin) / cos.
    assert heights[15, 0].item() == pytest.approx(-(0.8 - 0.75 * math.sin(lean)) / math.cos(lean), abs=1e-5)


def test_a_robot_in_the_mirror_sees_the_mirror_image(make_env):
    w, x, y, z = quaternion.from_rotation_vector(torch.tensor([0.15, 0.1, 0.6])).tolist()
    term, env = standing(make_env, pos=(0.1, 0.2, 0.9), quat=(w, x, y, z), slope=20.0, uphill=50.0)
    other, there = standing(make_env, pos=(0.1, -0.2, 0.9), quat=(w, -x, y, -z), slope=20.0, uphill=-50.0)
    index, sign = VoxelColumns.mirror_image(env, cell=0.1)
    heights = term(env)
    torch.testing.assert_close(heights[:, index] * sign, other(there), rtol=0.0, atol=1e-5)
    assert (heights - heights[:, index]).abs().max() > 0.1


def test_off_the_tile_the_ground_is_that_of_its_edge(make_env):
    term, env = standing(make_env, pos=(2.9, 0.0, 2.0), slope=30.0)
    heights = term(env)[0].view(16, 16) + 2.0
    edge = 3.0 * math.tan(math.radians(30.0))
    assert heights[2:, 0].max().item() == pytest.approx(edge, abs=1e-4)


def test_an_error_of_the_pose_tilts_what_is_seen(make_env):
    term, env = standing(make_env)
    term._turn = torch.tensor([[0.0, math.radians(1.0), 0.0]])
    term._position = torch.tensor([[0.0, 0.0, 0.01]])
    heights = term(env)[0].view(16, 16)
    assert heights[:, 8].mean().item() == pytest.approx(-0.81, abs=2e-3)
    assert (heights[15, 8] - heights[0, 8]).item() == pytest.approx(1.5 * math.tan(math.radians(1.0)), rel=0.01)


def test_the_presets_have_grids_of_their_own():
    assert VoxelColumns.scale_to("gpu") == {"cell": 0.05}
    assert VoxelColumns.scale_to("cpu") == {"cell": 0.1}
    group = ObservationGroupCfg(terms=Terms(columns=ObservationTermCfg(VoxelColumns, {"cell": 0.1})))
    env = SimpleNamespace(cfg=SimpleNamespace(observations={"voxels": group}))
    assert grid_of(env, "voxels").side == 16


def test_a_body_that_nobody_asked_for_cannot_be_read():
    bodies = Bodies(SimpleNamespace(model=None), [plane])
    with pytest.raises(UserError, match="no term of this environment reads bodies"):
        bodies.position("torso_link")
