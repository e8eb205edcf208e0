"""The slope-adaptive ZMP regulariser as a reward."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
import torch

from humoslope.errors import UserError
from humoslope.managers import RewardTermCfg
from humoslope.managers.terms import bind
from humoslope.mdp.zmp import ZmpRegulariser

MASS = 33.0
WEIGHT = MASS * 9.81
HEIGHT = 0.8
SLOPE = math.radians(30.0)
NORMAL = [-math.sin(SLOPE), 0.0, math.cos(SLOPE)]


def state(num_envs=2, com=(0.0, 0.0, HEIGHT), velocity=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0), force=WEIGHT / 2):
    """Feet to the left and right of the origin, each carrying `force`."""
    return SimpleNamespace(
        com_pos_w=torch.tensor([com]).repeat(num_envs, 1),
        com_lin_vel_w=torch.tensor([velocity]).repeat(num_envs, 1),
        foot_pos_w=torch.tensor([[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]).repeat(num_envs, 1, 1),
        foot_normal_w=torch.tensor([normal, normal]).repeat(num_envs, 1, 1),
        foot_force=torch.full((num_envs, 2), force),
    )


@pytest.fixture
def env(make_env):
    return make_env(2, robot=SimpleNamespace(total_mass=MASS), signals=state())


def accelerate(env, term, acc, steps=40, **rest):
    """The reward after a steady acceleration along x."""
    for k in range(steps):
        env.signals = state(velocity=(acc * env.step_dt * k, 0.0, 0.0), **rest)
        value = term(env)
    return value[0].item()


@pytest.mark.parametrize("normal", [[0.0, 0.0, 1.0], NORMAL])
@pytest.mark.parametrize("plane", ["support", "horizontal"])
def test_standing_still_right_above_the_anchor_scores_one_on_any_slope(env, plane, normal):
    term = ZmpRegulariser(env, plane=plane)
    env.signals = state(normal=normal)
    torch.testing.assert_close(term(env), torch.ones(2))


def test_the_score_falls_to_one_over_e_a_sigma_away(env):
    term = ZmpRegulariser(env, sigma=0.1)
    env.signals = state(com=(0.06, -0.08, HEIGHT))
    torch.testing.assert_close(term(env), torch.full((2,), math.exp(-1.0)))


def test_on_a_slope_the_support_plane_measures_along_the_ground_and_the_horizontal_one_does_not(env):
    # Accelerating uphill at 0.5 m/s^2: by hand as in tests/slope/test_zmp.py.
    t = HEIGHT / (9.81 - 0.5 * math.tan(SLOPE))
    along_the_slope, horizontal = 0.5 * t / math.cos(SLOPE), 0.5 * HEIGHT / 9.81
    adaptive = accelerate(env, ZmpRegulariser(env), 0.5, normal=NORMAL)
    naive = accelerate(env, ZmpRegulariser(env, plane="horizontal"), 0.5, normal=NORMAL)
    assert adaptive == pytest.approx(math.exp(-along_the_slope / 0.1), rel=1e-3)
    assert naive == pytest.approx(math.exp(-horizontal / 0.1), rel=1e-3)


def test_acceleration_is_averaged_over_steps(env):
    term = ZmpRegulariser(env, smoothing=0.5)
    believed = [0.0, 0.5, 0.75]  # of 1 m/s^2; the first difference needs two steps
    for k, acc in enumerate(believed):
        env.signals = state(velocity=(env.step_dt * k, 0.0, 0.0))
        assert term(env)[0].item() == pytest.approx(math.exp(-acc * HEIGHT / 9.81 / 0.1), rel=1e-3)


def test_an_impact_is_believed_only_up_to_a_limit_and_deviations_are_cut(env):
    term = ZmpRegulariser(env, sigma=0.1, largest_deviation=0.5)
    term(env)
    env.signals = state(velocity=(1e6, 0.0, 0.0))
    assert term(env)[0].item() == pytest.approx(math.exp(-5.0), rel=1e-5)
    env.signals = state(com=(40.0, 0.0, HEIGHT))
    term.reset(torch.tensor([True, True]))
    assert term(env)[0].item() == pytest.approx(math.exp(-5.0), rel=1e-5)


def test_a_robot_in_free_fall_scores_nothing(env):
    term = ZmpRegulariser(env)
    for k in range(40):
        env.signals = state(velocity=(0.0, 0.0, -9.81 * env.step_dt * k), force=0.0)
        value = term(env)
    assert value.tolist() == [0.0, 0.0]


def test_in_flight_the_last_support_plane_holds_and_feet_may_turn(env):
    # The CoM is off the anchor along the slope, so the plane decides the deviation.
    def value(term, **changes):
        env.signals = state(com=(0.1, 0.0, HEIGHT), **changes)
        return term(env)[0].item()

    term = ZmpRegulariser(env, flight_share=0.1)
    supported = value(term, normal=NORMAL)
    assert value(term, normal=[0.0, 0.0, 1.0], force=0.04 * WEIGHT) == pytest.approx(supported)
    assert value(term, normal=[0.0, 0.0, 1.0], force=0.06 * WEIGHT) == pytest.approx(math.exp(-1.0), rel=1e-5)
    assert supported < math.exp(-1.0)


def test_a_reset_forgets_acceleration_and_plane_of_its_worlds_alone(env, mask):
    term = ZmpRegulariser(env)
    accelerate(env, term, 1.0, normal=NORMAL)
    term.reset(mask(2, 1))
    # Teleported: another velocity, and still in the air, where the last plane would hold.
    env.signals = state(com=(0.1, 0.0, HEIGHT), velocity=(-3.0, 0.0, 0.0), force=0.0)
    moving, restarted = term(env).tolist()
    assert restarted == pytest.approx(math.exp(-1.0), rel=1e-5)  # no acceleration, on a level plane
    assert moving < 0.5 * restarted
    assert term(env)[1].item() == pytest.approx(math.exp(-1.0), rel=1e-5)


def test_whatever_the_signals_the_score_is_between_zero_and_one(env):
    term, generator = ZmpRegulariser(env), torch.Generator().manual_seed(0)
    for scale in (1.0, 100.0, 1e6):
        for _ in range(50):
            signals = state()
            for name, value in vars(signals).items():
                setattr(signals, name, value + scale * torch.randn(value.shape, generator=generator))
            signals.foot_normal_w = torch.nn.functional.normalize(signals.foot_normal_w, dim=-1)
            env.signals = signals
            value = term(env)
            assert value.isfinite().all()
            assert (value >= 0.0).all()
            assert (value <= 1.0).all()


def test_a_plane_that_does_not_exist_and_a_sigma_of_zero_are_refused(env):
    for params, message in (
        ({"plane": "sloped"}, "reward 'zmp': plane is 'sloped'; it must be 'support' or 'horizontal'"),
        ({"sigma": 0.0}, "reward 'zmp': sigma is 0; it must be positive"),
    ):
        with pytest.raises(UserError, match=message):
            bind("reward", "zmp", RewardTermCfg(ZmpRegulariser, params), env)
