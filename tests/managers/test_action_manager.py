"""Actions become joint targets."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch

from humoslope.errors import UserError
from humoslope.managers import ActionManager, JointPositionActionCfg

N, J = 3, 2
DEFAULT, SCALE = torch.tensor([0.1, -0.2]), torch.tensor([0.5, 0.25])


@pytest.fixture
def env(make_env):
    robot = SimpleNamespace(num_joints=J, default_joint_pos=tuple(DEFAULT.tolist()), action_scale=tuple(SCALE.tolist()))
    ctrl = torch.zeros(N, J, dtype=torch.float64)
    return make_env(N, robot=robot, sim=SimpleNamespace(state=lambda field: ctrl), ctrl=ctrl)


def test_an_action_of_zero_holds_the_default_pose_and_one_moves_by_the_robots_scale(env):
    actions = ActionManager(env, JointPositionActionCfg(scale_factor=2.0))
    actions.process(torch.zeros(N, J))
    torch.testing.assert_close(env.ctrl.float(), DEFAULT.expand(N, J))
    actions.process(torch.tensor([[1.0, -4.0]]).repeat(N, 1))
    torch.testing.assert_close(env.ctrl.float(), (DEFAULT + torch.tensor([1.0, -2.0])).expand(N, J))


def test_the_last_two_actions_are_remembered_until_the_env_starts_anew(env, mask):
    actions = ActionManager(env, JointPositionActionCfg())
    for value in (1.0, 2.0):
        actions.process(torch.full((N, J), value))
    assert actions.action.unique().tolist() == [2.0]
    assert actions.previous_action.unique().tolist() == [1.0]
    actions.reset(mask(N, 1))
    assert actions.action[:, 0].tolist() == [2.0, 0.0, 2.0]
    assert actions.previous_action[:, 0].tolist() == [1.0, 0.0, 1.0]
    torch.testing.assert_close(actions.default_ctrl, DEFAULT.expand(N, J))  # written by the simulation's reset


def test_a_policy_that_diverged_writes_no_nan_into_the_physics(env):
    actions = ActionManager(env, JointPositionActionCfg())
    given = torch.tensor([[torch.nan, torch.inf], [-torch.inf, 1.0], [0.0, 0.0]])
    actions.process(given)
    assert env.ctrl.isfinite().all()
    assert actions.action.isfinite().all()
    assert given[0, 0].isnan()  # the learner's own tensor is left alone


def test_the_learner_may_write_its_tensor_again(env):
    actions, given = ActionManager(env, JointPositionActionCfg()), torch.ones(N, J)
    actions.process(given)
    given.fill_(9.0)
    assert actions.action.unique().tolist() == [1.0]


def test_actions_are_not_clipped(env):
    ActionManager(env, JointPositionActionCfg()).process(torch.full((N, J), 6.0))
    torch.testing.assert_close(env.ctrl.float(), (DEFAULT + 6.0 * SCALE).expand(N, J))


def test_an_action_that_is_not_finite_is_reported(env):
    actions = ActionManager(env, JointPositionActionCfg())
    actions.process(torch.zeros(N, J))
    assert env.finite.report() == []
    env.finite.step = 5
    actions.process(torch.tensor([[torch.nan, torch.inf], [-torch.inf, 1.0], [0.0, 1e30]]))
    assert env.finite.report() == ["the action was not finite in 2 of 3 envs (first in step 5 since the last look)"]


@pytest.mark.parametrize("factor", [0.0, -1.0, float("nan"), float("inf")])
def test_a_scale_that_moves_nothing_or_anything_is_refused(env, factor):
    with pytest.raises(UserError, match=r"actions\.scale_factor is .*; it must be between 0 and 1,000, 0 excluded"):
        ActionManager(env, JointPositionActionCfg(scale_factor=factor))
