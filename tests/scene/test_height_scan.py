"""The ground patch: which points it scans, when, and which of them count."""

from __future__ import annotations

import math
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.scene.height_scan import HeightScan, HeightScanCfg
from humoslope.scene.tiles import Tiles
from humoslope.terrain import TerrainGridCfg, TerrainQueries, add_terrain
from humoslope.terrain.grid import Terrain, Tile, TileRowCfg
from humoslope.terrain.registry import Kind

LENGTH, WIDTH = 6.0, 4.0
GRADES = (0.0, 30.0, 40.0)  # of tiles side by side, across y


def uphill(x, y, grade, rng):
    return math.tan(math.radians(grade)) * x + 0.3 * (grade == 0.0)


def bumps(x, y, grade, rng):
    return rng.uniform(-0.2, 0.2, x.shape)


@pytest.fixture(scope="module")
def ramps() -> Terrain:
    kind = Kind("uphill", (0.0, 45.0), uphill)
    return TileRowCfg([Tile(kind, grade) for grade in GRADES], tile_length=LENGTH, tile_width=WIDTH).build()


class Robots:
    """Robots put at x, y from the start of their own tiles' centre lines, one in each column unless `num` says else."""

    def __init__(self, terrain: Terrain, cfg: HeightScanCfg | None = None, num: int = 3) -> None:
        self.tiles = Tiles(terrain, num, torch.device("cpu"))
        self.signals = SimpleNamespace()
        self.put([[3.0, 0.0]] * num, [0.0] * num)
        self.height_scan = HeightScan(cfg or HeightScanCfg(), self.signals, TerrainQueries(terrain, "cpu"), self.tiles)

    def put(self, places, degrees) -> None:
        place = torch.nn.functional.pad(torch.tensor(places), (0, 1), value=0.8)
        self.signals.root_pos_w = self.tiles.origin_w + place
        self.signals.heading_w = torch.tensor(degrees).deg2rad()


@given(
    heading=st.lists(st.floats(-180.0, 180.0), min_size=3, max_size=3),
    x=st.lists(st.floats(0.9, 5.1), min_size=3, max_size=3),
    y=st.lists(st.floats(-1.1, 1.1), min_size=3, max_size=3),
)
def test_each_robot_reads_its_own_tile_in_its_own_heading(ramps, heading, x, y):
    robots = Robots(ramps)
    robots.put(list(zip(x, y, strict=True)), heading)
    assert robots.height_scan.valid.all()
    d = robots.height_scan.descriptor
    assert d.valid.all()
    rise, way = torch.tensor(GRADES).deg2rad().tan(), torch.tensor(heading).deg2rad()
    torch.testing.assert_close(d.slope, torch.atan(rise * way.cos()), atol=2e-5, rtol=0)
    torch.testing.assert_close(d.bank, torch.atan(-rise * way.sin()), atol=2e-5, rtol=0)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), size=st.integers(2, 9), spacing=st.floats(0.05, 0.2))
def test_the_heights_are_those_that_rays_find_around_a_turned_robot(bumpy, seed, size, spacing):
    terrain, drop = bumpy
    rng = np.random.default_rng(seed)
    robots = Robots(terrain, HeightScanCfg(size, spacing), num=2)
    places, yaw = rng.uniform((2.0, -0.5), (4.0, 0.5), (2, 2)), rng.uniform(-180.0, 180.0, 2)
    robots.put(places.tolist(), yaw.tolist())
    axis = (np.arange(size) - 0.5 * (size - 1)) * spacing
    for world in range(2):
        x, y = robots.signals.root_pos_w[world, :2].tolist()
        c, s = math.cos(math.radians(yaw[world])), math.sin(math.radians(yaw[world]))
        expected = [drop(x + c * ahead - s * left, y + s * ahead + c * left) for ahead in axis for left in axis]
        np.testing.assert_allclose(robots.height_scan.heights_w[world], expected, atol=1e-3)


@pytest.fixture(scope="module")
def bumpy():
    """Rough ground, and what a vertical ray of MuJoCo finds there."""
    terrain = TileRowCfg([Tile(Kind("bumps", (0.0, 1.0), bumps), 0.0)], tile_length=LENGTH, tile_width=WIDTH).build()
    spec = mujoco.MjSpec()
    add_terrain(spec, terrain)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)

    def drop(x, y):
        geom = np.zeros(1, dtype=np.int32)
        down = np.array([0.0, 0.0, -1.0])
        return 5.0 - mujoco.mj_ray(model, data, np.array([x, y, 5.0]), down, None, 1, -1, geom, np.empty(3))

    return terrain, drop


def test_beyond_the_edge_of_its_tile_the_points_read_the_edge_and_do_not_count(ramps):
    # The level tile is 0.3 m above the start of the steep one beside it, which rises to 3.5 m.
    robots = Robots(ramps)
    robots.put([[3.0, 1.9], [3.0, -1.9], [5.7, 0.0]], [0.0, 0.0, 0.0])
    rows = robots.height_scan.valid.view(3, 7, 7)  # [N, rearmost first, rightmost first]
    left, right, ahead = (torch.ones(7, 7, dtype=torch.bool) for _ in range(3))
    left[:, 4:], right[:, :3], ahead[5:] = False, False, False
    assert rows.equal(torch.stack([left, right, ahead]))

    heights = robots.height_scan.heights_w.view(3, 7, 7)
    torch.testing.assert_close(heights[0], torch.full((7, 7), 0.3))
    along = 3.0 + 0.2 * (torch.arange(7) - 3)
    ramp = math.tan(math.radians(30.0)) * along[:, None].expand(7, 7)
    torch.testing.assert_close(heights[1], ramp, atol=1e-5, rtol=0)
    torch.testing.assert_close(
        heights[2, 5:], torch.full((2, 7), LENGTH * math.tan(math.radians(40.0))), atol=1e-5, rtol=0
    )

    d = robots.height_scan.descriptor
    assert d.valid.all()
    torch.testing.assert_close(d.slope, torch.tensor(GRADES).deg2rad(), atol=2e-5, rtol=0)
    torch.testing.assert_close(d.bank, torch.zeros(3), atol=2e-5, rtol=0)


@pytest.mark.parametrize("place", [[-2.0, 0.0], [8.0, 0.0], [3.0, 4.0], [-3.0, -9.0], [1e6, 0.0], [math.nan, 0.0]])
def test_far_off_its_tile_a_robot_has_no_ground_of_its_own_and_the_others_keep_theirs(ramps, place):
    robots = Robots(ramps)
    robots.put([[3.0, 0.0], place, [3.0, 0.0]], [0.0, 0.0, 0.0])
    assert robots.height_scan.valid.all(dim=1).tolist() == [True, False, True]
    assert not robots.height_scan.valid[1].any()
    d = robots.height_scan.descriptor
    assert d.valid.tolist() == [True, False, True]
    torch.testing.assert_close(d.slope, torch.tensor([0.0, 0.0, 40.0]).deg2rad(), atol=2e-5, rtol=0)


def test_the_ground_is_that_of_the_level_an_env_is_on():
    robots = Robots(TerrainGridCfg(columns={"ramp-up": 1.0}, levels=4, num_columns=1).build(), num=4)
    robots.tiles.set_level(torch.arange(4))
    robots.put([[5.0, 0.0]] * 4, [0.0] * 4)
    assert robots.height_scan.valid.all()
    torch.testing.assert_close(robots.height_scan.descriptor.slope, robots.tiles.grade, atol=1e-4, rtol=0)


def test_scan_and_plane_are_made_once_in_a_step_whoever_asks(make_stage1, monkeypatch):
    env = make_stage1(2)
    heights, d = env.height_scan.heights_w, env.height_scan.descriptor
    before, asked, height = heights.clone(), [], env.terrain.height
    monkeypatch.setattr(env.terrain, "height", lambda xy: asked.append(tuple(xy.shape)) or height(xy))
    env.step(torch.ones(2, 29))
    assert asked.count((2, 49, 2)) == 1, "the critic's height scan"
    assert env.height_scan.descriptor is env.height_scan.descriptor
    assert env.height_scan.descriptor is not d
    assert env.height_scan.heights_w is not heights
    assert asked.count((2, 49, 2)) == 1
    assert heights.equal(before), "what was handed out is never written again"


def test_the_robots_next_place_is_scanned_anew(ramps):
    robots = Robots(ramps)
    for degrees, way in ((0.0, 1.0), (180.0, -1.0)):
        robots.put([[3.0, 0.0]] * 3, [degrees] * 3)
        expected = way * torch.tensor(GRADES).deg2rad()
        torch.testing.assert_close(robots.height_scan.descriptor.slope, expected, atol=2e-5, rtol=0)


def test_a_scan_is_not_made_if_nothing_asks(make_stage1, monkeypatch):
    def blind(cfg):
        cfg.observations.critic.terms.height_scan = None

    env = make_stage1(2, blind)
    monkeypatch.setattr(env.height_scan, "_scan", lambda: pytest.fail("scanned"))
    env.step(torch.zeros(2, 29))


@pytest.mark.parametrize(
    ("cfg", "message"),
    [
        (HeightScanCfg(size=1), "size is 1; it must be between 2 and 64"),
        (HeightScanCfg(spacing=0.0), "spacing is 0; it must be between 0.001 and 100"),
        (HeightScanCfg(spacing=math.nan), "spacing is nan; it must be"),
        (HeightScanCfg(dead_band=3.0), "dead_band is 3; it must be between 0 and 1.5708, 1.5708 excluded"),
        (HeightScanCfg(dead_band=-0.1), "dead_band is -0.1; it must be"),
    ],
)
def test_an_impossible_patch_is_refused(ramps, cfg, message):
    with pytest.raises(UserError, match=message):
        Robots(ramps, cfg)
