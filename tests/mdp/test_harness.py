"""The training harness, and how it is taken away."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from humoslope.errors import UserError
from humoslope.mdp.harness import Harness, HarnessCurriculum

WEIGHT = 33.0 * 9.81
ROOT, TORSO = 1, 2  # body ids
EVERYWHERE = torch.tensor([True])


@pytest.fixture(scope="module")
def hang(make_env):
    """hang(rotation, spin, scale=...): the wrench [body, force and torque] on a robot whose torso leans and spins."""

    def make(torso=None, spin=(0.0, 0.0, 0.0), **params):
        wrench = torch.zeros(1, 3, 6, dtype=torch.float64)
        quat = (torso or Rotation.identity()).as_quat(scalar_first=True)
        env = make_env(
            1,
            robot=SimpleNamespace(total_mass=33.0, root_body="pelvis", torso_body="torso"),
            body_id={"pelvis": ROOT, "torso": TORSO}.__getitem__,
            sim=SimpleNamespace(state=lambda field: wrench),
            signals=SimpleNamespace(
                torso_quat_w=torch.tensor(np.array([quat]), dtype=torch.float32), torso_ang_vel_w=torch.tensor([spin])
            ),
        )
        harness = Harness(env, **params)
        harness(env, EVERYWHERE)
        return wrench[0].numpy()

    return make


def test_at_full_strength_it_carries_35_percent_of_the_weight_at_the_root_and_only_there(hang):
    wrench = hang()
    np.testing.assert_allclose(wrench[ROOT], [0.0, 0.0, 0.35 * WEIGHT, 0.0, 0.0, 0.0], rtol=1e-6)
    np.testing.assert_allclose(wrench[TORSO], 0.0, atol=1e-6)
    np.testing.assert_array_equal(wrench[0], 0.0)


@given(heading=st.floats(-180.0, 180.0), lean=st.floats(1.0, 80.0), direction=st.floats(-180.0, 180.0))
def test_the_torque_turns_a_leaning_torso_back_upright_whatever_its_heading(hang, heading, lean, direction):
    axis = Rotation.from_euler("z", direction, degrees=True).apply([1.0, 0.0, 0.0])
    tilt = Rotation.from_rotvec(np.radians(lean) * axis)
    torque = hang(tilt * Rotation.from_euler("z", heading, degrees=True), stiffness=120.0)[TORSO, 3:]
    np.testing.assert_allclose(torque, -120.0 * np.sin(np.radians(lean)) * axis, atol=1e-3)


def test_it_damps_roll_and_pitch_and_leaves_the_robot_free_to_turn(hang):
    torque = hang(spin=(1.0, -2.0, 5.0), damping=3.0)[TORSO, 3:]
    np.testing.assert_allclose(torque, [-3.0, 6.0, 0.0], atol=1e-5)


@pytest.mark.parametrize("scale", [0.0, 0.25, 1.0])
def test_its_scale_weakens_all_of_it(hang, scale):
    lean = Rotation.from_euler("y", 20.0, degrees=True)
    np.testing.assert_allclose(hang(lean, scale=scale), scale * hang(lean), atol=1e-5)


@pytest.mark.parametrize("scale", [-0.1, 1.1])
def test_a_scale_beyond_its_range_is_refused(hang, scale):
    with pytest.raises(UserError, match="harness: scale .* must be between 0 and 1"):
        hang(scale=scale)


# Withdrawal


@pytest.fixture
def withdrawal(make_env):
    """withdraw(steps, falling, share): the scale after so many steps of robots falling and walking so."""
    env = make_env(
        4,
        sim=SimpleNamespace(state=lambda field: torch.zeros(4, 3, 6)),
        robot=SimpleNamespace(total_mass=33.0, root_body="pelvis", torso_body="torso"),
        body_id={"pelvis": ROOT, "torso": TORSO}.__getitem__,
        commands=SimpleNamespace(velocity=torch.tensor([[0.5, 0.0, 0.1]] * 3 + [[0.0, 0.0, 0.0]])),
    )
    env.events = {"harness": Harness(env), "push": lambda env, mask: None}

    def withdraw(steps, falling=False, share=1.0, fresh=None):
        env.terminations = SimpleNamespace(terminated=torch.full((4,), falling))
        env.signals = SimpleNamespace(root_lin_vel_t=share * env.commands.velocity)
        for _ in range(steps):
            scale = withdraw.term(env, torch.zeros(4, dtype=torch.bool))
        return scale.item()

    withdraw.env = env
    withdraw.make = lambda **params: HarnessCurriculum(env, **{"rate": 0.5, "memory_s": 1.0, **params})
    withdraw.term = withdraw.make()
    return withdraw


def test_nothing_is_withdrawn_before_the_robots_have_proven_themselves(withdrawal):
    assert withdrawal(20) == 1.0


def test_from_robots_that_walk_and_hardly_fall_it_is_withdrawn_at_its_rate_down_to_nothing(withdrawal):
    withdrawal(500)
    before = withdrawal(1)
    assert withdrawal(10) == pytest.approx(before - 10 * 0.5 * 0.02, abs=1e-5) or before == 0.0
    assert withdrawal(2000) == 0.0


def test_it_takes_rate_off_each_second(withdrawal):
    withdrawal.term = withdrawal.make(rate=0.01)
    before = withdrawal(500)
    assert 0.0 < before < 1.0
    assert withdrawal(500) == pytest.approx(before - 0.01 * 10.0, abs=1e-4)


def test_from_robots_that_fall_nothing_is_withdrawn(withdrawal):
    assert withdrawal(1000, falling=True) == 1.0


def test_from_robots_that_stand_in_it_nothing_is_withdrawn(withdrawal):
    assert withdrawal(1000, share=0.5) == 1.0


def test_it_stays_as_it_is_when_robots_begin_to_fall_again_and_never_comes_back(withdrawal):
    withdrawal.term = withdrawal.make(rate=0.01)
    withdrawal(1000)
    withdrawal(50, falling=True)
    held = withdrawal(1, falling=True)
    assert 0.0 < held < 1.0
    assert withdrawal(500, falling=True) == held


def test_the_log_shows_and_others_read_the_present_scale(withdrawal):
    value = withdrawal(500)
    assert withdrawal.term.scale.item() == value == withdrawal.env.events["harness"].scale.item()


def test_withdrawal_goes_on_where_its_state_was_taken(withdrawal):
    withdrawal.term = withdrawal.make(rate=0.01)
    withdrawal(700)
    state = withdrawal.term.state_dict()
    expected = [withdrawal(1) for _ in range(5)]

    withdrawal.env.events["harness"] = Harness(withdrawal.env)
    withdrawal.term = withdrawal.make(rate=0.01)
    withdrawal.term.load_state_dict(state)
    assert [withdrawal(1) for _ in range(5)] == pytest.approx(expected, abs=1e-6)
    assert all(isinstance(value, float) for value in state.values())


def test_only_a_harness_can_be_withdrawn(withdrawal):
    with pytest.raises(UserError, match="event 'push' is not a Harness"):
        HarnessCurriculum(withdrawal.env, event="push")
