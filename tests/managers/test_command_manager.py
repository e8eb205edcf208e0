"""What the policy is asked to do."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
import torch
from hypothesis import assume, example, given
from hypothesis import strategies as st

from humoslope.errors import UserError
from humoslope.managers import CommandManager, VelocityCommandCfg, commanded_and_walked
from humoslope.managers.command import MODES, SKILLS

N = 1000
STEERED = VelocityCommandCfg(
    heading_share=1.0, standing_share=0.0, heading_gain=0.5, lateral_gain=0.3, yaw_rate_limit=10.0
)


@pytest.fixture(scope="module")
def make_commands(make_env):
    def make(
        cfg: VelocityCommandCfg,
        num_envs: int = N,
        heading: float = 0.0,
        y: float = 0.0,
        step_dt: float = 0.02,
        free: bool | torch.Tensor = False,
    ) -> CommandManager:
        signals = SimpleNamespace(
            root_pos_w=torch.tensor([[0.0, y, 0.0]]).repeat(num_envs, 1), heading_w=torch.full((num_envs,), heading)
        )
        omnidirectional = torch.as_tensor(free).expand(num_envs)
        tiles = SimpleNamespace(
            origin_w=torch.zeros(num_envs, 3),
            omnidirectional=omnidirectional,
            has_omnidirectional=bool(omnidirectional.any()),
        )
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


@given(dt=st.sampled_from([0.004, 0.01, 0.02, 0.1 / 3]), steps=st.integers(1, 100))
@example(dt=0.004, steps=400)
@example(dt=0.1 / 3, steps=399)
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
    with pytest.raises(UserError, match=rf"command.{name} is \(2, 1\); it must be \(lowest, highest\)"):
        make_commands(VelocityCommandCfg(**{name: (2.0, 1.0)}))


@pytest.mark.parametrize("name", ["heading_share", "standing_share"])
@pytest.mark.parametrize("share", [-0.1, 1.5, math.nan])
def test_a_share_of_envs_beyond_all_or_nothing_is_refused(make_commands, name, share):
    with pytest.raises(UserError, match=f"command.{name} is {share:g}; it must be between 0 and 1"):
        make_commands(VelocityCommandCfg(**{name: share}))


@pytest.mark.parametrize(
    ("resample_s", "message"),
    [
        ((0.0, 1.0), r"\.resample_s is \(0, 1\); it must be \(lowest, highest\), each positive"),
        ((0.005, 1.0), ": resample_s is 0.005 s; it must be finite and at least one control step of 0.02 s"),
        ((1.0, math.inf), r"\.resample_s is \(1, inf\); it must be"),
        ((2.0, 1.0), r"\.resample_s is \(2, 1\); it must be"),
        ((math.nan, 1.0), r"\.resample_s is \(nan, 1\); it must be"),
    ],
)
def test_commands_that_hold_for_no_time_are_refused(make_commands, resample_s, message):
    with pytest.raises(UserError, match=f"command{message}"):
        make_commands(VelocityCommandCfg(resample_s=resample_s))


@pytest.mark.parametrize("name", ["heading_gain", "lateral_gain", "yaw_rate_limit"])
@pytest.mark.parametrize("value", [-0.1, math.nan, math.inf])
def test_steering_that_is_no_number_from_zero_up_is_refused(make_commands, name, value):
    with pytest.raises(UserError, match=f"command.{name} is {value:g}; it must be (0 or more|between 0 and 20)"):
        make_commands(VelocityCommandCfg(**{name: value}))


# Tiles that are walked in any direction

ALL = {"forward": 0.4, "backward": 0.1, "sideways": 0.2, "turning": 0.3}
EVERY_WAY = VelocityCommandCfg(
    modes=ALL, backward=(0.1, 0.4), sideways=(0.2, 0.5), turning=(0.3, 0.9), standing_share=0.1, heading_share=0.5
)


def modes_of(velocity):
    """The mode of each command [N, 3], by what it asks for; "standing" for nothing."""
    forward, left, turn = velocity.T
    kinds = {
        "forward": (forward > 0.0) & (left == 0.0),
        "backward": (forward < 0.0) & (left == 0.0),
        "sideways": (forward == 0.0) & (left != 0.0),
        "turning": (forward == 0.0) & (left == 0.0) & (turn != 0.0),
        "standing": (velocity == 0.0).all(dim=1),
    }
    assert (torch.stack(list(kinds.values())).sum(dim=0) == 1).all()
    return kinds


def test_every_mode_has_its_share_of_the_commands_to_move_and_stays_in_its_range(make_commands):
    commands = make_commands(EVERY_WAY, num_envs=20_000, free=True)
    velocity = commands.velocity
    kinds = modes_of(velocity)
    for i, name in enumerate(SKILLS):
        assert kinds[name].equal(commands.skill == i)
    assert kinds["standing"].float().mean().item() == pytest.approx(0.1, abs=0.01)
    for name, share in ALL.items():
        assert kinds[name].float().mean().item() == pytest.approx(0.9 * share, abs=0.015), name
    for name, column, sign in (("forward", 0, 1.0), ("backward", 0, -1.0)):
        low, high = EVERY_WAY.speed if name == "forward" else EVERY_WAY.backward
        drawn = sign * velocity[kinds[name], column]
        assert low - 1e-6 <= drawn.min() < low + 0.02
        assert high - 0.02 < drawn.max() <= high + 1e-6
    for name, column, (low, high) in (("sideways", 1, EVERY_WAY.sideways), ("turning", 2, EVERY_WAY.turning)):
        drawn = velocity[kinds[name], column]
        assert low - 1e-6 <= drawn.abs().min() < low + 0.02
        assert high - 0.02 < drawn.abs().max() <= high + 1e-6
        assert (drawn > 0.0).float().mean().item() == pytest.approx(0.5, abs=0.05)


@given(shares=st.fixed_dictionaries({}, optional=dict.fromkeys(MODES, st.sampled_from((0.0, 1.0, 3.0)))))
def test_a_mode_without_a_share_is_never_drawn(make_commands, shares):
    assume(sum(shares.values()) > 0.0)
    cfg = VelocityCommandCfg(modes=shares, standing_share=0.0, heading_share=0.0, yaw_rate=(0.1, 0.1))
    kinds = modes_of(make_commands(cfg, num_envs=400, free=True).velocity)
    for name in MODES:
        assert kinds[name].any().item() == (shares.get(name, 0.0) > 0.0)
        assert cfg.asks_for(name) == (shares.get(name, 0.0) > 0.0)


def test_a_tile_walked_along_x_gets_forward_commands_alone(make_commands):
    free = torch.arange(N) % 2 == 0
    kinds = modes_of(make_commands(EVERY_WAY, free=free).velocity)
    assert (kinds["forward"] | kinds["standing"])[~free].all()
    assert kinds["turning"][free].any()


def test_without_modes_draws_and_random_numbers_are_what_they_were(make_commands):
    commands = make_commands(VelocityCommandCfg())
    torch.manual_seed(5)
    commands.reset(torch.ones(N, dtype=torch.bool))
    after = torch.get_rng_state()
    torch.manual_seed(5)
    random = torch.rand(N, 6)
    assert torch.get_rng_state().equal(after)
    speed = torch.lerp(torch.tensor(0.3), torch.tensor(0.8), random[:, 0]).masked_fill(random[:, 4] < 0.05, 0.0)
    assert commands.velocity[:, 0].equal(speed)


def test_turning_robots_do_not_steer_and_count_as_moving(make_commands):
    cfg = VelocityCommandCfg(modes={"turning": 1.0}, heading_share=1.0, standing_share=0.0)
    commands = make_commands(cfg, heading=1.0, free=True)
    before = commands.velocity
    commands._env.signals.heading_w = torch.full((N,), 2.0)
    commands.step()
    assert commands.velocity.equal(before)
    assert commands.moving.all()


@given(heading=st.floats(-math.pi, math.pi), turned=st.floats(-3.0, 3.0), y=st.floats(-3.0, 3.0))
def test_on_a_hillside_a_robot_holds_the_heading_at_which_its_command_was_drawn(make_commands, heading, turned, y):
    commands = make_commands(STEERED, 1, heading, y, free=True)
    assert commands.velocity[0, 2].abs() < 1e-6
    commands._env.signals.heading_w = torch.tensor([math.remainder(heading + turned, 2.0 * math.pi)])
    commands.step()
    assert commands.velocity[0, 2].item() == pytest.approx(-0.5 * turned, abs=1e-5)


def test_a_robot_whose_command_is_not_drawn_anew_keeps_its_heading_target(make_commands):
    commands = make_commands(STEERED, 2, 0.3, free=True)
    commands._env.signals.heading_w = torch.full((2,), 0.7)
    commands.reset(torch.tensor([True, False]))
    torch.testing.assert_close(commands.velocity[:, 2], torch.tensor([0.0, -0.2]))


def test_the_bounds_of_commands_are_those_that_are_drawn():
    assert VelocityCommandCfg().bounds() == ((0.3, 0.8), (0.0, 0.0), (-0.3, 0.3))
    assert EVERY_WAY.bounds() == ((-0.4, 0.8), (-0.5, 0.5), (-0.9, 0.9))


@pytest.mark.parametrize(
    ("change", "free", "said"),
    [
        ({"modes": {"sidewards": 1.0}}, True, "command mode 'sidewards' does not exist; did you mean 'sideways'"),
        ({"modes": {"turning": -1.0}}, True, "command.modes is {'turning': -1.0}; of 'turning', it must be 0 or more"),
        ({"modes": {"turning": math.nan}}, True, "command.modes is {'turning': nan}; of 'turning', it must be"),
        ({"modes": {"turning": 0.0}}, True, "the shares of modes sum to 0"),
        ({"modes": ALL}, False, "command: mode 'backward' has a share, but every tile is walked along x; .*'hillside'"),
        (
            {"backward": (0.4, 0.1)},
            True,
            r"command.backward is \(0.4, 0.1\); it must be \(lowest, highest\), each",
        ),
        ({"turning": (-0.4, 0.1)}, True, r"command.turning is \(-0.4, 0.1\); it must be"),
        ({"sideways": (0.1, math.inf)}, True, r"command.sideways is \(0.1, inf\); it must be"),
    ],
)
def test_modes_that_cannot_be_drawn_are_refused_in_one_sentence(make_commands, change, free, said):
    with pytest.raises(UserError, match=said) as caught:
        make_commands(VelocityCommandCfg(**change), free=free)
    assert "\n" not in str(caught.value)


def test_forward_alone_needs_no_hillside(make_commands):
    assert (make_commands(VelocityCommandCfg(modes={"forward": 1.0})).velocity[:, 0] >= 0.0).all()


# Commanded and walked speed

speeds = st.floats(-2.0, 2.0)


@given(forward=speeds, left=speeds, share=st.floats(-1.5, 1.5), across=speeds, up=speeds)
def test_what_is_walked_counts_in_the_commanded_direction_whichever_that_is(make_env, forward, left, share, across, up):
    """A robot that walks `share` of its command, and strays at right angles to it."""
    speed = math.hypot(forward, left)
    assume(speed > 1e-3)
    velocity = [share * forward - across * left / speed, share * left + across * forward / speed, up]
    env = make_env(
        1,
        commands=SimpleNamespace(velocity=torch.tensor([[forward, left, 0.3]])),
        signals=SimpleNamespace(root_lin_vel_t=torch.tensor([velocity])),
    )
    commanded, walked = commanded_and_walked(env)
    assert commanded.item() == pytest.approx(speed, abs=1e-5)
    assert walked.item() == pytest.approx(share * speed, abs=1e-4)


def test_robots_that_are_commanded_to_stand_count_for_nothing_however_they_move(make_env):
    env = make_env(
        2,
        commands=SimpleNamespace(velocity=torch.zeros(2, 3)),
        signals=SimpleNamespace(root_lin_vel_t=torch.tensor([[3.0, 0.0, 0.0], [-1.0, 2.0, 0.0]])),
    )
    assert [speed.tolist() for speed in commanded_and_walked(env)] == [[0.0, 0.0], [0.0, 0.0]]


FORWARD = (0.5, 0.0, 0.1)  # m/s, m/s, rad/s


def on_the_way(mode: str, variety: float, side: float) -> torch.Tensor:
    """The command of this mode that is 0.3 m/s or 0.6 rad/s in the end: it points ever further round from ahead."""
    angles = {"forward": 0.0, "sideways": 0.5 * math.pi * variety, "backward": math.pi * variety}
    if mode == "turning":
        rest = 1.0 - variety
        return torch.tensor([0.5 * rest, 0.0, 0.1 * rest + 0.6 * side * variety])
    speed = 0.5 if mode == "forward" else 0.5 + (0.3 - 0.5) * variety
    return torch.tensor([speed * math.cos(angles[mode]), side * speed * math.sin(angles[mode]), 0.1])


@given(variety=st.floats(0.0, 1.0))
@example(variety=0.0)
@example(variety=1.0)
@pytest.mark.parametrize("mode", ["forward", "backward", "sideways", "turning"])
def test_variety_takes_commands_from_forward_to_what_their_mode_asks_for(make_commands, mode, variety):
    exact = {name: (value, value) for name, value in zip(("speed", "lateral", "yaw_rate"), FORWARD, strict=True)}
    sizes = {"backward": (0.3, 0.3), "sideways": (0.3, 0.3), "turning": (0.6, 0.6)}
    cfg = VelocityCommandCfg(standing_share=0.0, heading_share=0.0, modes={mode: 1.0}, **exact, **sizes)
    commands = make_commands(cfg, free=True)
    of_skill = torch.tensor([name == mode for name in SKILLS[1:]])
    commands.variety = torch.where(of_skill, variety, torch.rand(4))  # the others' do not matter
    commands.reset(torch.ones(N, dtype=torch.bool))
    errors = []
    for side in (-1.0, 1.0):
        errors.append((commands.velocity - on_the_way(mode, variety, side)).abs().amax(dim=1))
    error = torch.stack(errors)  # [2, N]
    assert error.amin(dim=0).max() < 1e-5  # every robot is asked for one of the two
    assert error.amin(dim=1).max() < 1e-5  # and each is asked for


def test_fewer_robots_are_asked_to_stand_without_variety(make_commands):
    commands = make_commands(VelocityCommandCfg(standing_share=0.5), free=True)
    for variety in (0.0, 0.4, 1.0):
        commands.variety = torch.tensor([0.0, 0.0, 0.0, variety])
        commands.reset(torch.ones(N, dtype=torch.bool))
        assert (~commands.moving).float().mean().item() == pytest.approx(0.5 * variety, abs=0.05)
