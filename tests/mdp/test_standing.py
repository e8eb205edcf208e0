"""Rewards for standing act where standing is commanded, and are least where nothing moves."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from humoslope.mdp import standing
from humoslope.mdp.declare import joint_image
from robots.unitree_g1 import UNITREE_G1

TERMS = (standing.both_feet_down, standing.foot_speed, standing.creep, standing.joint_vel_l2, standing.posture_l1)
COSTS = TERMS[1:]
DEFAULT = torch.tensor([UNITREE_G1.default_joint_pos])
SIDEWAYS = torch.tensor([1.0, -1.0, 1.0])


def worlds(make_env, stands, seed=0):
    """An env in any state for each entry of `stands`."""
    n, generator = len(stands), torch.Generator().manual_seed(seed)

    def random(*shape):
        return torch.randn(n, *shape, generator=generator)

    signals = SimpleNamespace(
        joint_pos=DEFAULT + 0.1 * random(29),
        joint_vel=random(29),
        foot_lin_vel_w=random(2, 3),
        foot_contact=random(2) > 0.0,
        root_lin_vel_t=random(3),
    )
    moving = SimpleNamespace(moving=~torch.tensor(stands))
    return make_env(n, signals=signals, robot=UNITREE_G1, default_joint_pos=DEFAULT[0], commands=moving)


@pytest.mark.parametrize("term", TERMS)
@given(seed=st.integers(0, 1000))
def test_every_term_is_zero_where_the_command_is_to_move_and_there_alone(make_env, term, seed):
    env = worlds(make_env, [True, False] * 4, seed)
    value = term(env)
    assert value[1::2].count_nonzero() == 0
    if term is standing.both_feet_down:
        assert value[::2].tolist() == env.signals.foot_contact[::2].all(dim=1).float().tolist()
    else:
        assert (value[::2] > 0.0).all()


@pytest.mark.parametrize("term", TERMS)
@given(seed=st.integers(0, 1000))
def test_every_term_is_the_same_in_the_mirror(make_env, term, seed):
    env = worlds(make_env, [True] * 4, seed)
    before, s = term(env), env.signals
    index, sign = joint_image(UNITREE_G1)
    s.joint_pos, s.joint_vel = s.joint_pos[:, index] * sign, s.joint_vel[:, index] * sign
    s.foot_lin_vel_w, s.foot_contact = s.foot_lin_vel_w.flip(1) * SIDEWAYS, s.foot_contact.flip(1)
    s.root_lin_vel_t = s.root_lin_vel_t * SIDEWAYS
    torch.testing.assert_close(term(env), before)


@given(slope=st.floats(-20.0, 20.0), uphill=st.floats(-180.0, 180.0), heading=st.floats(-180.0, 180.0))
def test_a_robot_that_stands_still_on_a_slope_costs_nothing_and_creeping_costs_its_speed_along_the_ground(
    make_env, pose, slope, uphill, heading
):
    ground = Rotation.from_euler("ZY", [uphill, -slope], degrees=True)
    down = ground.apply([-1.0, 0.0, 0.0])
    quat = Rotation.from_euler("Z", heading, degrees=True).as_quat(scalar_first=True)
    loaded = {"left": [0.0, 0.0, 160.0], "right": [0.0, 0.0, 160.0]}
    joints = torch.tensor(UNITREE_G1.default_joint_pos)
    for name in ("left", "right"):
        joints[UNITREE_G1.joint_names.index(f"{name}_ankle_pitch_joint")] += math.radians(slope)
    moving = SimpleNamespace(moving=torch.tensor([False]))

    def values(speed):
        posed = pose(slope, uphill, root_quat_w=quat, foot_force_w=loaded, root_lin_vel_w=speed * down)
        posed.put(foot_lin_vel_w={"left": speed * down, "right": np.zeros(3)})
        posed.put_joints(torch.zeros(29), torch.zeros(29), joints)
        posed.signals.refresh()
        env = make_env(1, signals=posed.signals, robot=UNITREE_G1, default_joint_pos=DEFAULT[0], commands=moving)
        return {term.__name__: term(env).item() for term in TERMS}

    still, creeping = values(0.0), values(0.05)
    assert still == pytest.approx(
        {"both_feet_down": 1.0, "foot_speed": 0.0, "creep": 0.0, "joint_vel_l2": 0.0, "posture_l1": 0.0}, abs=1e-5
    )
    assert creeping["creep"] == pytest.approx(0.05, abs=1e-5)
    assert creeping["foot_speed"] == pytest.approx(0.05, abs=1e-5)


def test_a_lifted_foot_earns_nothing_and_its_speed_costs(make_env, pose):
    moving = SimpleNamespace(moving=torch.tensor([False]))
    posed = pose(foot_force_w={"left": [0.0, 0.0, 320.0]}, foot_lin_vel_w={"right": [0.3, 0.0, 0.4]})
    env = make_env(1, signals=posed.signals, commands=moving)
    assert standing.both_feet_down(env).item() == 0.0
    assert standing.foot_speed(env).item() == pytest.approx(0.5)


def test_the_posture_leaves_the_ankles_free_by_default_and_nothing_else(make_env):
    for index, name in enumerate(UNITREE_G1.joint_names):
        env = worlds(make_env, [True])
        env.signals.joint_pos = DEFAULT.clone()
        env.signals.joint_pos[0, index] += 0.2
        assert standing.posture_l1(env).item() == pytest.approx(0.0 if "ankle" in name else 0.2, abs=1e-6), name
