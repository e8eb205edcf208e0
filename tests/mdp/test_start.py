"""Robots start with their soles just above the ground, wherever and however they stand; tiles have room for it."""

from __future__ import annotations

import math
import re
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.managers import TermCfg, TerminationTermCfg, Terms, VelocityCommandCfg
from humoslope.mdp import events, room, terminations
from humoslope.mdp.curricula import TerrainLevels
from humoslope.mdp.soles import Soles
from humoslope.ranges import parameters_of
from humoslope.scene.tiles import Tiles
from humoslope.slope import quaternion
from humoslope.terrain import TerrainGridCfg, TerrainQueries, Tile, TileRowCfg
from humoslope.terrain.registry import Kind
from robots.unitree_g1 import UNITREE_G1
from terrains.surfaces import rough

LIFT = 0.01
FEET = [name for side in UNITREE_G1.foot_geoms for name in side]
RNG = np.random.default_rng(0)
DIRECTIONS = RNG.normal(size=(3000, 3))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
ALONG = {"along": (-0.15, 0.15), "across": (-0.5, 0.5)}


def hillside(slope, uphill, bumps, seed=0):
    """A plane that rises by `slope` degrees towards `uphill` degrees, with bumps on top."""

    def heights(x, y, grade, rng):
        along = x * math.cos(math.radians(uphill)) + y * math.sin(math.radians(uphill))
        return math.tan(math.radians(slope)) * along + rough(x, y, rng, bumps, start=-np.inf)

    return TileRowCfg([Tile(Kind("hillside", (0.0, 0.0), heights), 0.0)], tile_length=6.0, tile_width=6.0, seed=seed)


def start_of(terrain, model, num_envs, yaw, joints=(0.0, 0.0), joints_last=True):
    """Start poses [N, nq] that the reset events draw."""
    limits = np.array([model.joint(name).range for name in UNITREE_G1.joint_names])
    env = SimpleNamespace(
        num_envs=num_envs,
        device=torch.device("cpu"),
        robot=UNITREE_G1,
        cfg=SimpleNamespace(terminations=Terms(), curriculum=Terms(), command=VelocityCommandCfg()),
        sim=SimpleNamespace(model=model, known_rows=lambda mask: mask.nonzero().squeeze(1)),
        terrain=TerrainQueries(terrain, "cpu"),
        tiles=Tiles(terrain, num_envs, torch.device("cpu")),
        joint_range=torch.tensor(limits, dtype=torch.float32),
        uniform=lambda low, high, *shape: torch.empty(num_envs, *shape).uniform_(low, high),
    )
    root = (0.0, 0.0, UNITREE_G1.default_root_height, 1.0, 0.0, 0.0, 0.0)
    env.start_qpos = torch.tensor([*root, *UNITREE_G1.default_joint_pos]).repeat(num_envs, 1)
    env.start_qvel = torch.zeros(num_envs, 35)
    reset, everywhere = events.ResetOnTile(env, yaw=yaw, **ALONG), torch.ones(num_envs, dtype=torch.bool)
    if not joints_last:
        events.reset_joints(env, everywhere, joints, (0.0, 0.0))
    reset(env, everywhere)
    if joints_last:
        events.reset_joints(env, everywhere, joints, (0.0, 0.0))
    reset.reset(everywhere)
    return env.start_qpos, env.terrain


def clearance(model, qpos, ground):
    """Smallest vertical distance of the shapes under the feet from the ground, m, with MuJoCo's own kinematics."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos.numpy()
    mujoco.mj_kinematics(model, data)
    found = []
    for name in FEET:
        surface = data.geom(name).xpos + model.geom(name).size[0] * DIRECTIONS
        below = ground.height(torch.tensor(surface[:, :2], dtype=torch.float32)).double().numpy()
        found.append((surface[:, 2] - below).min())
    return min(found)


@settings(max_examples=25)
@given(
    slope=st.floats(0.0, 35.0),
    uphill=st.floats(0.0, 360.0),
    yaw=st.floats(-math.pi, math.pi),
    bumps=st.sampled_from((0.0, 0.03, 0.1)),
    joints=st.sampled_from((0.0, 0.3)),
    joints_last=st.booleans(),
    seed=st.integers(0, 99),
)
@example(slope=35.0, uphill=90.0, yaw=0.0, bumps=0.1, joints=0.0, joints_last=True, seed=1)
@example(slope=0.0, uphill=0.0, yaw=0.0, bumps=0.0, joints=0.05, joints_last=True, seed=1)
def test_the_lowest_point_of_the_soles_starts_at_the_lift_on_any_ground_at_any_heading_and_pose(
    g1, slope, uphill, yaw, bumps, joints, joints_last, seed
):
    torch.manual_seed(seed)
    terrain = hillside(slope, uphill, bumps, seed).build()
    starts, ground = start_of(terrain, g1, 3, (yaw, yaw), (-joints, joints), joints_last)
    for qpos in starts:
        assert LIFT - 0.002 <= clearance(g1, qpos, ground) <= LIFT + 0.001


# Forward kinematics


@given(seed=st.integers(0, 1000))
def test_the_points_of_the_soles_lie_on_the_lower_half_of_the_feet_s_spheres(g1, seed):
    rng = np.random.default_rng(seed)
    limits = np.array([g1.joint(name).range for name in UNITREE_G1.joint_names])
    quat = rng.normal(size=4)
    qpos = np.concatenate([[0.0, 0.0, 0.0], quat / np.linalg.norm(quat), rng.uniform(*limits.T)])
    data = mujoco.MjData(g1)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(g1, data)
    q = torch.tensor(qpos[None], dtype=torch.float32)
    points = Soles(g1, UNITREE_G1, torch.device("cpu"))(q, quaternion.matrix(q[:, 3:7]))[0].reshape(8, -1, 3)
    for place, name in zip(points.double().numpy(), FEET, strict=True):
        centre, radius = data.geom(name).xpos, g1.geom(name).size[0]
        np.testing.assert_allclose(np.linalg.norm(place - centre, axis=1), radius, atol=1e-5)
        assert (place[:, 2] <= centre[2] + 1e-5).all()
        assert place[:, 2].min() == pytest.approx(centre[2] - radius, abs=1e-5)


OTHER_FEET = """
<mujoco><worldbody><body name="root" pos="0 0 1"><freejoint/><geom size="0.1"/>
  <body name="left" pos="0 0.1 -0.5"><joint name="l" axis="0 1 0" pos="0 0 0.2" ref="0.1"/>
    <geom name="lc" type="capsule" size="0.03" fromto="-0.05 0 0 0.15 0 0.02"/></body>
  <body name="thigh" pos="0 -0.1 -0.2"><body name="right" pos="0 0 -0.3"><joint name="r" axis="1 0 0"/>
    <geom name="rb" type="box" size="0.1 0.05 0.02" pos="0.03 0 0" euler="0 10 0"/></body></body>
</body></worldbody></mujoco>"""


@given(left=st.floats(-1.0, 1.0), right=st.floats(-1.0, 1.0))
def test_feet_of_other_shapes_and_legs_of_other_joints_are_found_too(left, right):
    model = mujoco.MjModel.from_xml_string(OTHER_FEET)
    robot = SimpleNamespace(
        name="other", root_body="root", foot_bodies=("left", "right"), foot_geoms=(("lc",), ("rb",))
    )
    data = mujoco.MjData(model)
    data.qpos[:] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, left, right]
    mujoco.mj_kinematics(model, data)
    q = torch.tensor(data.qpos[None], dtype=torch.float32)
    found = Soles(model, robot, torch.device("cpu"))(q, torch.eye(3)[None])[0][:, 2].min().item()
    capsule = data.geom("lc")
    ends = [capsule.xpos[2] + s * capsule.xmat[8] * model.geom("lc").size[1] for s in (-1.0, 1.0)]
    corners = np.array([(x, y, z) for x in (-0.1, 0.1) for y in (-0.05, 0.05) for z in (-0.02, 0.02)])
    box = (data.geom("rb").xpos + corners @ data.geom("rb").xmat.reshape(3, 3).T)[:, 2]
    assert found == pytest.approx(min(min(ends) - 0.03, box.min()), abs=1e-5)


def test_a_leg_that_slides_is_refused_by_name():
    model = mujoco.MjModel.from_xml_string(OTHER_FEET.replace('name="r" axis', 'name="r" type="slide" axis'))
    robot = SimpleNamespace(name="other", root_body="root", foot_bodies=("left", "right"), foot_geoms=((), ()))
    with pytest.raises(UserError, match="other: leg joint 'r' must be a hinge"):
        Soles(model, robot, torch.device("cpu"))


# Room on the tile


def levels(**params):
    return Terms(levels=TermCfg(TerrainLevels, params))


def tile_of(length, width, margin, along=(-0.15, 0.15), across=(-0.5, 0.5), *, climb=None, free=False, **command):
    """Builds the start event on a tile of this size, as far as it concerns the room on it."""
    ends = Terms(off_tile=TerminationTermCfg(terminations.off_tile, {"margin": margin}, time_out=True))
    env = SimpleNamespace(
        cfg=SimpleNamespace(terminations=ends, curriculum=climb or Terms(), command=VelocityCommandCfg(**command)),
        tiles=SimpleNamespace(
            length=length, width=width, spawn_x=0.75, has_straight=not free, has_omnidirectional=free
        ),
    )
    room.check_room(env, along, max(map(abs, across)), edge=1.0)


@given(
    length=st.floats(0.8, 12.0),
    width=st.floats(0.2, 6.0),
    margin=st.floats(0.0, 1.0),
    offset=st.floats(0.0, 0.5),
    across=st.floats(0.0, 1.0),
    up=st.floats(0.1, 0.95),
)
def test_a_tile_without_room_is_refused_with_the_length_or_width_that_would_do(
    length, width, margin, offset, across, up
):
    def build(length, width):
        tile_of(length, width, margin, (-offset, offset), (-across, across), climb=levels(up=up))

    starts_inside = 0.75 - offset >= margin
    last = 0.75 + offset
    reachable = up * (length - last) <= length - last - margin + 1e-9
    room = starts_inside and last + margin <= length and across + margin <= width / 2 and reachable
    for _ in range(3):
        try:
            build(length, width)
        except UserError as error:
            said = str(error)
            assert "\n" not in said
            if not starts_inside:
                assert "within" in said
                return
            number = float(re.search(r"must be at least (\S+) m", said)[1])
            assert not room
            if "tile_length" in said:
                assert number > length
                length = number * (1.0 + 1e-5)  # it is printed with six digits
            else:
                assert number > width
                width = number * (1.0 + 1e-5)
        else:
            break
    build(length, width)
    assert starts_inside


def test_a_level_is_earned_by_the_share_that_levels_ask_for_unless_told_otherwise():
    usual = parameters_of(TerrainLevels)["up"].default
    shortest = 0.75 + 0.15 + 0.5 / (1.0 - usual)  # from the furthest start on
    tile_of(shortest + 0.01, 5.0, 0.5, climb=levels())
    with pytest.raises(UserError, match=f"for {usual:.0%} of the way and a margin of 0.5 m"):
        tile_of(shortest - 0.01, 5.0, 0.5, climb=levels())


def widest_margin(cfg):
    cfg.terminations.off_tile.params["margin"] = 5.0


def far_across(cfg):
    cfg.events.root.params["across"] = (-5.0, 5.0)


@pytest.mark.parametrize(
    ("override", "said"),
    [
        (widest_margin, "event 'root': robots start from 0.6 m on, but within 5 m of the tile's edge"),
        (far_across, "event 'root': the tile is 8 m wide; .* tile_width must be at least 10.6 m"),
    ],
)
def test_an_environment_without_room_for_its_robots_is_refused_when_it_is_built(make_stage1, override, said):
    with pytest.raises(UserError, match=said):
        make_stage1(4, override)


# Room for commands, and hillsides


@given(back=st.floats(0.0, 1.0), aside=st.floats(0.0, 1.0), shortest=st.floats(0.5, 9.0), right=st.booleans())
def test_a_command_that_a_tile_walked_along_x_cannot_hold_is_refused(back, aside, shortest, right):
    """Behind the start there are 0.75 - 0.15 - 0.3 m, beside it 2.5 - 0.5 - 0.3 m."""
    assume(min(abs(back * shortest - 0.3), abs(aside * shortest - 1.7)) > 1e-6)
    lateral = (-aside, 0.0) if right else (0.0, aside)
    fits = back * shortest <= 0.3 and aside * shortest <= 1.7
    command = {"speed": (-back, 0.5), "lateral": lateral, "resample_s": (shortest, 12.0)}
    if fits:
        tile_of(10.0, 5.0, 0.3, **command)
        return
    with pytest.raises(UserError, match=r"command: (speed|lateral) \(.*\) m/s carries a robot .* 'hillside'\.$"):
        tile_of(10.0, 5.0, 0.3, **command)


@pytest.mark.parametrize("mode", ["backward", "sideways"])
@given(speed=st.floats(0.1, 3.0))
def test_a_mode_faster_than_any_tile_can_hold_is_refused_with_the_speed_that_would_do(mode, speed):
    longest = math.hypot(10.0 - 1.6, 5.0 - 1.6)

    def build(speed, share=1.0):
        tile_of(10.0, 5.0, 0.3, free=True, modes={mode: share, "forward": 1.0}, **{mode: (0.1, speed)})

    assume(abs(8.0 * speed - longest) > 1e-3)
    if 8.0 * speed < longest:
        build(speed)
        return
    with pytest.raises(UserError, match=rf"command: {mode} goes up to .* no tile has more than .* at most") as caught:
        build(speed)
    build(float(re.search(r"at most (\S+) m/s", str(caught.value))[1]))
    build(speed, share=0.0)


@pytest.mark.parametrize(
    ("length", "width", "said"),
    [
        (1.9, 5.0, "a length of 1.9 m; .* tile_length must be at least 2 m"),
        (5.0, 1.9, "a width of 1.9 m; .*tile_width"),
    ],
)
def test_a_hillside_without_room_for_starts_is_refused(length, width, said):
    tile_of(5.0, 5.0, 0.3, free=True)
    with pytest.raises(UserError, match=said):
        tile_of(length, width, 0.3, free=True)


def test_starts_on_a_hillside_lie_inside_the_margin_of_off_tile(make_stage1):
    def change(cfg):
        cfg.scene.terrain = TerrainGridCfg(columns={"hillside": 1.0}, levels=1, num_columns=1)
        cfg.events.root.params["edge"] = 0.5

    with pytest.raises(UserError, match="event 'root': .* within 0.6 m of it .* edge must be at least 0.6 m"):
        make_stage1(2, change)


def test_on_hillsides_robots_start_anywhere_with_any_heading_and_on_other_tiles_as_ever(make_stage1):
    def change(cfg):
        cfg.scene.terrain = TerrainGridCfg(columns={"hillside": 1.0, "ramp-up": 1.0}, levels=4, num_columns=2)
        cfg.events = Terms(root=cfg.events.root)
        cfg.curriculum = Terms()

    env = make_stage1(400, change)
    everywhere = torch.ones(400, dtype=torch.bool)
    env.tiles.set_level(torch.arange(400) % 4)
    env._restart(everywhere)
    free = env.tiles.omnidirectional
    assert free.tolist() == [True] * 200 + [False] * 200
    signals, offset = env.signals, env.signals.root_pos_w - env.tiles.origin_w
    for axis, low, high in ((0, 1.0, 9.0), (1, -1.5, 1.5)):
        place = offset[free, axis]
        assert low - 1e-4 <= place.min() < low + 0.15
        assert high - 0.15 < place.max() <= high + 1e-4
    assert (offset[~free, 0] - 0.75).abs().max() <= 0.15 + 1e-4
    assert signals.heading_w[~free].abs().max() <= 0.3 + 1e-4
    quarter = torch.histc(signals.heading_w[free], 4, -math.pi, math.pi)
    assert quarter.min() > 30
    assert not signals.foot_contact.any()
    assert signals.foot_height.min() > 0.0
    # The soles are lifted out of the slope: 32 degrees over 0.2 m of foot and the width of the stance.
    assert signals.foot_height[free].min(dim=1).values.max() < 0.1
