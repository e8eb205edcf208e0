"""What the policy is asked to do."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
import torch
from hypothesis import assume, given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.managers import CommandManager, VelocityCommandCfg

N = 1000
STEERED = VelocityCommandCfg(
    heading_share=1.0, standing_share=0.0, heading_gain=0.5, lateral_gain=0.3, yaw_rate_limit=10.0
)


@pytest.fixture(scope="module")
def make_commands(make_env):
    def make(
        cfg: VelocityCommandCfg, num_envs: int = N, heading: float = 0.0, y: float = 0.0, step_dt: float = 0.02
    ) -> CommandManager:
        signals = SimpleNamespace(
            root_pos_w=torch.tensor([[0.0, y, 0.0]]).repeat(num_envs, 1), heading_w=torch.full((num_envs,), heading)
        )
        tiles = SimpleNamespace(origin_w=torch.zeros(num_envs, 3))
        commands = CommandManager(make_env(num_envs, signals=signals, tiles=tiles, step_dt=step_dt), cfg)
        commands.reset(torch.ones(num_envs, dtype=torch.bool))
        return commands

    return make


def test_commands_fill_their_ranges_and_stay_within(make_commands):
    cfg = VelocityCommandCfg(
        speed=(0.3, 0.8), lateral=(-0.2, 0.1), yaw_rate=(-0.4, 0.3), heading_share=0.0, standing_share=0.0
    )
    velocity = make_commands(cfg).velocity
    for column, (low, high) in enumerate((cfg.speed, cfg.lateral, cfg.yaw_rate)):
        drawn = velocity[:, column]
        assert low <= drawn.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < drawn.max() <= high


def test_the_asked_share_of_envs_stands_and_is_asked_for_nothing(make_commands):
    commands = make_commands(VelocityCommandCfg(standing_share=0.3))
    standing = ~commands.moving
    assert 0.25 < standing.float().mean() < 0.35
    assert commands.velocity[standing].count_nonzero() == 0
    assert (commands.velocity[commands.moving, 0] > 0.0).all()


def test_the_asked_share_of_envs_steers(make_commands):
    cfg = VelocityCommandCfg(heading_share=0.6, standing_share=0.0, yaw_rate=(0.1, 0.3))
    steers = make_commands(cfg).velocity[:, 2] == 0.0  # they already face along their tile
    assert 0.55 < steers.float().mean() < 0.65


@given(heading=st.floats(-math.pi, math.pi), y=st.floats(-5.0, 5.0))
def test_an_env_turns_to_its_direction_of_travel_by_the_shorter_way(make_commands, heading, y):
    error = -0.3 * y - heading
    shorter = math.remainder(error, 2.0 * math.pi)
    assume(abs(abs(shorter) - math.pi) > 1e-3)  # straight behind it, both ways are equally short
    assert make_commands(STEERED, 1, heading, y).velocity[0, 2] == pytest.approx(0.5 * shorter, abs=1e-5)


def test_an_env_that_looks_back_turns_on_over_the_back_and_not_all_the_way_round(make_commands):
    # Heading 3 rad with the target at -0.6: 2.68 rad to the left, not 3.6 to the right.
    assert make_commands(STEERED, 1, 3.0, 2.0).velocity[0, 2] == pytest.approx(0.5 * (2 * math.pi - 3.6), abs=1e-5)


@given(y=st.floats(-2.0, 2.0))
def test_an_env_off_its_centre_line_turns_towards_it(make_commands, y):
    assert make_commands(STEERED, 1, 0.0, y).velocity[0, 2] == pytest.approx(-0.5 * 0.3 * y, abs=1e-5)


@given(heading=st.floats(-3.1, 3.1), y=st.floats(-5.0, 5.0))
def test_steering_stays_within_its_limit(make_commands, heading, y):
    cfg = VelocityCommandCfg(heading_share=1.0, standing_share=0.0, yaw_rate_limit=0.3)
    assert make_commands(cfg, 1, heading, y).velocity[0, 2].abs() <= 0.3 + 1e-6


def test_a_steered_path_comes_back_to_the_centre_line_and_stays(make_commands):
    commands = make_commands(VelocityCommandCfg(heading_share=1.0, standing_share=0.0, speed=(0.5, 0.5)), num_envs=1)
    signals = commands._env.signals
    signals.root_pos_w, signals.heading_w = torch.tensor([[0.0, 1.0, 0.0]]), torch.tensor([2.0])
    for _ in range(600):  # a minute of a unicycle that follows its command
        commands.step()
        forward, _, turn = commands.velocity[0]
        signals.heading_w = signals.heading_w + 0.1 * turn
        heading = signals.heading_w[0]
        signals.root_pos_w = signals.root_pos_w + 0.1 * forward * torch.stack(
            [heading.cos(), heading.sin(), torch.zeros(())]
        )
    assert abs(signals.root_pos_w[0, 1]) < 0.05
    assert abs(math.remainder(signals.heading_w[0].item(), 2 * math.pi)) < 0.05


def test_commands_hold_until_their_time_is_over(make_commands):
    cfg = VelocityCommandCfg(heading_share=0.0, standing_share=0.0, resample_s=(1.0, 2.0))
    commands = make_commands(cfg, num_envs=20)
    first = commands.velocity.clone()
    for _ in range(49):
        commands.step()
    assert commands.velocity.equal(first)
    for _ in range(51):
        commands.step()
    assert (commands.velocity[:, 0] != first[:, 0]).all()


@given(dt=st.sampled_from([0.004, 0.01, 0.02, 0.1 / 3]), steps=st.integers(1, 400))
def test_a_command_holds_for_its_duration_in_control_steps_and_not_one_more(make_commands, dt, steps):
    cfg = VelocityCommandCfg(heading_share=0.0, standing_share=0.0, resample_s=(steps * dt, steps * dt))
    commands = make_commands(cfg, num_envs=3, step_dt=dt)
    for _ in range(2):
        before = commands.velocity
        for _ in range(steps - 1):
            commands.step()
        assert commands.velocity.equal(before)
        commands.step()
        assert (commands.velocity[:, 0] != before[:, 0]).all()


def test_only_envs_in_the_mask_get_a_new_command(make_commands):
    commands = make_commands(VelocityCommandCfg(heading_share=0.0, standing_share=0.1))
    before, moving = commands.velocity, commands.moving
    mask = torch.arange(N) < N // 2
    commands.reset(mask)
    assert commands.velocity[~mask].equal(before[~mask])
    assert commands.moving[~mask].equal(moving[~mask])
    assert (commands.velocity[mask, 0] != before[mask, 0]).float().mean() > 0.9


def test_steering_follows_the_heading_between_two_draws(make_commands):
    commands = make_commands(STEERED)
    commands._env.signals.heading_w = torch.full((N,), 0.4)
    commands.step()
    torch.testing.assert_close(commands.velocity[:, 2], torch.full((N,), -0.2))


def test_nothing_is_drawn_where_every_command_is_known_to_hold_and_steering_goes_on(make_commands):
    commands = make_commands(STEERED)
    commands._env.sim = SimpleNamespace(known_empty=lambda mask: not mask.any())
    commands._env.signals.heading_w = torch.full((N,), 0.4)
    linear, random = commands.velocity[:, :2], torch.get_rng_state()
    commands.step()
    assert torch.get_rng_state().equal(random)
    assert commands.velocity[:, :2].equal(linear)
    torch.testing.assert_close(commands.velocity[:, 2], torch.full((N,), -0.2))


@pytest.mark.parametrize("name", ["speed", "lateral", "yaw_rate"])
def test_a_range_the_wrong_way_round_is_named(make_commands, name):
    with pytest.raises(UserError, match=rf"command: {name} \(2, 1\) must be \(lowest, highest\)"):
        make_commands(VelocityCommandCfg(**{name: (2.0, 1.0)}))


@pytest.mark.parametrize("name", ["heading_share", "standing_share"])
@pytest.mark.parametrize("share", [-0.1, 1.5, math.nan])
def test_a_share_of_envs_beyond_all_or_nothing_is_refused(make_commands, name, share):
    with pytest.raises(UserError, match=f"command: {name} {share} must be between 0 and 1"):
        make_commands(VelocityCommandCfg(**{name: share}))


@pytest.mark.parametrize(
    ("resample_s", "message"),
    [
        ((0.0, 1.0), "resample_s is 0 s; it must be finite and at least one control step of 0.02 s"),
        ((0.005, 1.0), "resample_s is 0.005 s"),
        ((1.0, math.inf), "resample_s is inf s"),
        ((2.0, 1.0), r"resample_s \(2.0, 1.0\) must be two positive durations in s, the shortest first"),
        ((math.nan, 1.0), "resample_s .* must be two positive durations"),
    ],
)
def test_commands_that_hold_for_no_time_are_refused(make_commands, resample_s, message):
    with pytest.raises(UserError, match=f"command: {message}"):
        make_commands(VelocityCommandCfg(resample_s=resample_s))


@pytest.mark.parametrize("name", ["heading_gain", "lateral_gain", "yaw_rate_limit"])
@pytest.mark.parametrize("value", [-0.1, math.nan, math.inf])
def test_steering_that_is_no_number_from_zero_up_is_refused(make_commands, name, value):
    with pytest.raises(UserError, match=f"command: {name} is {value:g}; it must be 0 or more"):
        make_commands(VelocityCommandCfg(**{name: value}))
