"""Randomisation, resets and pushes."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.managers import Terms
from humoslope.mdp import events
from humoslope.scene.drives import Drives
from humoslope.scene.masses import Masses
from robots.unitree_g1 import UNITREE_G1

FEET = [name for side in UNITREE_G1.foot_geoms for name in side]


class FakeSim:
    """A model with a copy of each expanded field per world."""

    def __init__(self, model, num_worlds):
        self.model, self.recomputed, self._fields = model, 0, {}
        self.num_worlds, self.device = num_worlds, torch.device("cpu")

    def expand(self, field):
        values = torch.as_tensor(np.array(getattr(self.model, field)))
        return self._fields.setdefault(field, values.repeat(self.num_worlds, *[1] * values.dim()))

    def recompute_constants(self):
        self.recomputed += 1


@pytest.fixture(scope="module")
def worlds(make_env, g1):
    """worlds(8): that many worlds of the G1."""

    def make(num_envs, **attributes):
        sim = FakeSim(g1, num_envs)
        parts = {"robot": UNITREE_G1, "drives": Drives(sim, UNITREE_G1), "masses": Masses(sim)}
        return make_env(num_envs, sim=sim, body_id=lambda name: body_id(g1, name), **parts, **attributes)

    return make


def body_id(model, name):
    names = [model.body(i).name for i in range(model.nbody)]
    return names.index(name) if name in names else -1


# Friction


@given(steepest=st.floats(0.0, 50.0), low=st.floats(0.1, 1.0), width=st.floats(0.0, 1.0))
def test_every_tile_can_be_walked_with_the_friction_that_is_drawn(worlds, steepest, low, width):
    env = worlds(50, tiles=SimpleNamespace(steepest=torch.full((50,), math.radians(steepest))))
    events.randomize_friction(env, torch.ones(50, dtype=torch.bool), (low, low + width), slope_margin=0.15)
    mu = env.sim.expand("geom_friction")[:, env.sim.model.geom(FEET[0]).id, 0]
    least = math.tan(math.radians(steepest)) + 0.15
    assert mu.min() >= max(low, least) - 1e-5
    assert mu.max() <= max(low + width, least) + 1e-5


def test_all_of_a_worlds_foot_geoms_share_one_friction_and_nothing_else_is_touched(worlds, mask):
    env = worlds(8, tiles=SimpleNamespace(steepest=torch.zeros(8)))
    before = env.sim.expand("geom_friction").clone()
    events.randomize_friction(env, mask(8, 2, 5), (0.3, 0.4), slope_margin=0.15)
    friction = env.sim.expand("geom_friction")
    feet = [env.sim.model.geom(name).id for name in FEET]
    others = [i for i in range(env.sim.model.ngeom) if i not in feet]
    assert (friction[:, feet, 0] == friction[:, feet[:1], 0]).all()
    assert (friction[[2, 5]][:, feet, 0] < 0.41).all()
    assert friction[2, feet[0], 0] != friction[5, feet[0], 0]
    assert friction[[0, 1, 3, 4, 6, 7]].equal(before[[0, 1, 3, 4, 6, 7]])
    assert friction[:, others].equal(before[:, others])
    assert friction[:, :, 1:].equal(before[:, :, 1:])


# Mass, gains


def test_added_mass_stays_in_its_range_and_takes_the_inertia_along(worlds, mask):
    env = worlds(40)
    model, torso = env.sim.model, body_id(env.sim.model, "torso_link")
    events.randomize_mass(env, torch.arange(40) < 30, "torso_link", (-1.0, 3.0))
    added = env.sim.expand("body_mass")[:, torso] - model.body_mass[torso]
    assert -1.0 <= added.min() < -0.5
    assert 2.5 < added.max() <= 3.0
    assert added[30:].count_nonzero() == 0
    share = env.sim.expand("body_mass")[:, torso] / model.body_mass[torso]
    expected = share[:, None] * torch.tensor(model.body_inertia[torso])
    torch.testing.assert_close(env.sim.expand("body_inertia")[:, torso], expected, rtol=1e-5, atol=0)
    assert env.sim.recomputed == 1


def test_more_mass_cannot_be_taken_away_than_there_is(worlds):
    env = worlds(2)
    with pytest.raises(UserError, match=r"torso_link weighs .* kg; -50 kg cannot be added to it\."):
        events.randomize_mass(env, torch.ones(2, dtype=torch.bool), "torso_link", (-50.0, 3.0))


@pytest.mark.parametrize(
    ("event", "params"), [(events.randomize_mass, {"added": (0.0, 1.0)}), (events.randomize_com, {"offset": 0.01})]
)
def test_a_body_that_does_not_exist_is_named(worlds, event, params):
    with pytest.raises(UserError, match="body 'trunk' does not exist"):
        event(worlds(2), torch.ones(2, dtype=torch.bool), body="trunk", **params)


def test_the_centre_of_mass_moves_from_where_the_model_has_it_however_often(worlds):
    env = worlds(40)
    torso = body_id(env.sim.model, "torso_link")
    for _ in range(5):
        events.randomize_com(env, torch.ones(40, dtype=torch.bool), "torso_link", 0.03)
    moved = env.sim.expand("body_ipos")[:, torso] - torch.tensor(env.sim.model.body_ipos[torso])
    assert 0.02 < moved.abs().max() <= 0.03 + 1e-6


def test_gains_are_scaled_joint_by_joint_and_the_spring_still_pulls_to_its_target(worlds):
    env = worlds(20)
    events.randomize_gains(env, torch.arange(20) < 10, (0.8, 1.2), (0.5, 2.0))
    gain, bias = env.sim.expand("actuator_gainprm"), env.sim.expand("actuator_biasprm")
    assert gain[:, :, 0].equal(-bias[:, :, 1])
    stiffness = gain[:, :, 0] / torch.tensor(UNITREE_G1.stiffness)
    damping = -bias[:, :, 2] / torch.tensor(UNITREE_G1.damping)
    for share, low, high in ((stiffness, 0.8, 1.2), (damping, 0.5, 2.0)):
        assert low - 1e-5 <= share[:10].min() < share[:10].max() <= high + 1e-5
        torch.testing.assert_close(share[10:], torch.ones_like(share[10:]))
    assert stiffness[0].unique().numel() > 20


# Pushes and resets


def test_a_push_changes_horizontal_velocity_in_its_worlds_by_up_to_its_speed(make_env, mask):
    qvel = torch.ones(50, 35, dtype=torch.float64)
    env = make_env(50, sim=SimpleNamespace(state=lambda field: qvel))
    events.push(env, torch.arange(50) < 25, speed=0.5)
    kick = qvel - 1.0
    assert kick[25:].count_nonzero() == 0
    assert kick[:, 2:].count_nonzero() == 0
    assert 0.4 < kick[:, :2].max() <= 0.5
    assert -0.5 <= kick[:, :2].min() < -0.4


@pytest.mark.parametrize(("strictness", "most"), [(0.0, 0.2), (0.5, 0.35), (1.0, 0.5)])
def test_a_push_grows_with_the_strictness_of_the_harness(make_env, strictness, most):
    qvel = torch.zeros(2000, 35)
    env = make_env(2000, sim=SimpleNamespace(state=lambda field: qvel))
    env.events = {"harness": SimpleNamespace(strictness=torch.tensor(strictness))}
    events.push(env, torch.ones(2000, dtype=torch.bool), speed=0.5, harness="harness", least=0.4)
    assert 0.99 * most < qvel.abs().max() <= most + 1e-6


@pytest.mark.parametrize(("strictness", "most"), [(0.0, [0.2, 0.2, 0.2]), (0.5, [0.2, 0.275, 0.35])])
def test_a_push_grows_with_the_level_until_it_is_full(make_env, strictness, most):
    qvel, level = torch.zeros(6000, 35), torch.tensor([0, 2, 4, 8]).repeat(1500)
    env = make_env(6000, sim=SimpleNamespace(state=lambda field: qvel))
    env.tiles = SimpleNamespace(level=level)
    env.events = {"harness": SimpleNamespace(strictness=torch.tensor(strictness))}
    events.push(env, torch.ones(6000, dtype=torch.bool), speed=0.5, harness="harness", full_level=4, least=0.4)
    for tile, largest in zip((0, 2, 4, 8), [*most, most[-1]], strict=True):
        assert 0.99 * largest < qvel[level == tile].abs().max() <= largest + 1e-6


def test_a_push_grows_with_the_level_without_a_harness_too(make_env):
    qvel, level = torch.zeros(4000, 35), torch.tensor([1, 2]).repeat(2000)
    env = make_env(4000, sim=SimpleNamespace(state=lambda field: qvel), tiles=SimpleNamespace(level=level))
    events.push(env, torch.ones(4000, dtype=torch.bool), speed=0.5, full_level=2, least=0.0)
    assert 0.247 < qvel[level == 1].abs().max() <= 0.25
    assert 0.495 < qvel[level == 2].abs().max() <= 0.5


def test_joints_start_near_their_default_and_never_beyond_their_range(make_env):
    limits = torch.tensor([[-1.0, 1.0], [-0.05, 0.05]])
    env = make_env(200, robot=SimpleNamespace(num_joints=2), joint_range=limits)
    env.start_qpos, env.start_qvel = torch.zeros(200, 9), torch.zeros(200, 8)
    events.reset_joints(env, torch.ones(200, dtype=torch.bool), position=(-0.2, 0.2), velocity=(0.0, 0.3))
    assert 0.15 < env.start_qpos[:, 7].abs().max() <= 0.2
    assert env.start_qpos[:, 8].abs().max() == pytest.approx(0.05)
    assert env.start_qpos[:, :7].count_nonzero() == 0
    assert 0.25 < env.start_qvel[:, 6:].max() <= 0.3
    assert env.start_qvel[:, :6].count_nonzero() == 0


def test_on_every_tile_of_stage_one_robots_start_with_their_feet_just_above_the_ground(make_stage1):
    def only_the_reset(cfg):
        cfg.events = Terms(root=cfg.events.root)
        cfg.curriculum = Terms()

    env = make_stage1(200, only_the_reset)  # ten worlds in each of twenty columns
    everywhere = torch.ones(200, dtype=torch.bool)
    env.tiles.set_level(torch.arange(200) % env.tiles.num_levels)
    env._restart(everywhere)
    signals = env.signals
    assert not signals.foot_contact.any()
    assert signals.body_force.count_nonzero() == 0
    assert signals.foot_height.min() > 0.0
    free = env.tiles.omnidirectional
    assert free.sum() == 110
    assert signals.foot_height.amin(dim=1).max() < 0.1  # on a hillside a heel touches first, and one foot
    assert signals.foot_height[~free].max() < 0.03
    offset = (signals.root_pos_w - env.tiles.origin_w)[~free]
    assert (offset[:, 0] - env.tiles.spawn_x).abs().max() <= 0.15 + 1e-4
    assert offset[:, 1].abs().max() <= 0.5 + 1e-4
    assert 0.2 < signals.heading_w[~free].abs().max() <= 0.3 + 1e-4
    assert offset[:, 0].unique().numel() > 80
