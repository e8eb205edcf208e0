"""The slope gait adapter's terms: on a robot that walks by hand-made readings, and on the real one, posed on ramps."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
import torch
from scipy.spatial.transform import Rotation

from humoslope.errors import UserError
from humoslope.managers import RewardTermCfg
from humoslope.managers.terms import bind
from humoslope.mdp import bsga
from humoslope.mdp.bsga_memory import AirTime, SlopeGait, StanceWork, Swing
from humoslope.mdp.declare import joint_image
from humoslope.slope import bsga as functions
from humoslope.slope.descriptor import terrain_descriptor
from robots.unitree_g1 import UNITREE_G1

NAMES = UNITREE_G1.joint_names
DEG = math.pi / 180.0
DEAD_BAND = 3.0 * DEG
WEIGHT = UNITREE_G1.total_mass * 9.81
SWING = {"beta0": 0.45, "beta1": 1.0, "theta_clip": 30.0 * DEG}
TERMS = {  # with the slope, in degrees, on which a good walker earns it
    "com": (bsga.ComHeight, {"nominal": 0.69}, 20.0),
    "hip": (bsga.HipPropulsion, {}, 20.0),
    "brake": (bsga.KneeBraking, {}, -20.0),
    "stride": (bsga.Stride, {}, -20.0),
    "swing": (bsga.SwingHip, SWING, 20.0),
}
every_term = pytest.mark.parametrize("name", TERMS)


def ground(*slopes, valid=True):
    """The patch of worlds that stand on planes of these slopes, in degrees; or off the ground, if it is not valid."""
    along = torch.tensor([-0.4, 0.0, 0.4])
    x, y = (axis.flatten() for axis in torch.meshgrid(along, along, indexing="ij"))
    points = torch.stack([torch.stack([x, y, math.tan(slope * DEG) * x], dim=1) for slope in slopes])
    return SimpleNamespace(descriptor=terrain_descriptor(points, torch.full(points.shape[:2], valid), DEAD_BAND))


def asking(*speeds, moving=True):
    velocity = torch.tensor([[speed, 0.0, 0.0] for speed in speeds])
    return SimpleNamespace(velocity=velocity, moving=torch.full((len(speeds),), moving))


def joints(**values):
    """[J] zero but for the joints that end in these names, such as hip_pitch=..., or left_knee=... for one side."""
    row = torch.zeros(len(NAMES))
    for name, value in values.items():
        for i, joint in enumerate(NAMES):
            if joint.endswith(f"{name}_joint"):
                row[i] = value
    return row


def walking(k, slope, speed=0.5, apart=0.1, air=15, vel=1.0, drive=None):
    """Readings in step `k` of a walk in which the feet take turns, 20 control steps each, `air` of them in the air.

    Posture, work and length of step are what the terms ask for; `drive` is 1 where the legs propel and -1 where they
    brake.
    """
    side, phase = (k // 20) % 2, k % 20
    force = torch.tensor([[WEIGHT, WEIGHT]])
    force[0, side] *= not 3 <= phase < 3 + air
    pos = joints(hip_pitch=-0.45 - max(slope, 0.0) * DEG, knee=0.45 + 0.01 * abs(slope))
    drive = math.copysign(1.0, slope) if drive is None else drive
    return SimpleNamespace(
        root_lin_vel_t=torch.tensor([[speed, 0.0, 0.0]]),
        com_height=torch.tensor([0.69]),
        joint_pos=pos[None],
        joint_vel=torch.full((1, len(NAMES)), vel),
        joint_torque=drive * joints(hip_pitch=20.0, knee=20.0)[None],
        foot_force=force,
        foot_contact=force > 1.0,
        foot_pos_w=torch.tensor([[[apart, 0.1, 0.0], [0.0, -0.1, 0.0]]]),
        along_ground=lambda v: v,
    )


@pytest.fixture
def env(make_env):
    return make_env(1, robot=UNITREE_G1, commands=asking(0.5))


def term_of(env, name, slope=None, **params):
    func, defaults, best = TERMS[name]
    env.height_scan = ground(best if slope is None else slope)
    env.observers = {"slope_gait": SlopeGait(env)}
    return func(env, **{**defaults, **params}), best if slope is None else slope


def values(env, term, slope, steps, start=0, **changes):
    """What the term is worth in each of these steps."""
    earned = []
    for k in range(start, start + steps):
        env.signals = walking(k, slope, **changes)
        earned.append(term(env).item())
    return torch.tensor(earned)


def again(make, *args, **changes):
    """The same readings in 150 steps."""
    return (make(*args, **changes) for _ in range(150))


# What a good walker earns, and where


@every_term
def test_who_walks_as_the_slope_asks_earns_most_of_every_term(env, name):
    term, slope = term_of(env, name)
    earned = values(env, term, slope, 120)[80:]
    # A swing counts from 0.1 s after lift-off: ten of twenty steps.
    assert earned.mean() > (0.45 if name == "swing" else 0.8)
    assert (earned <= 1.0).all()


@pytest.mark.parametrize(
    ("slope", "earning"),
    [
        (0.0, {"com", "swing"}),
        (2.9, {"com", "swing"}),
        (3.1, {"com", "swing", "hip"}),
        (-2.9, {"com", "swing"}),
        (-3.1, {"com", "swing", "brake", "stride"}),
    ],
)
def test_hips_are_judged_uphill_knees_and_steps_downhill_and_neither_on_the_flat(env, slope, earning):
    def earns(name):
        term, _ = term_of(env, name, slope)
        # Two steps, in which the legs both propel and brake.
        return any(values(env, term, slope, 1, start=k, drive=(-1.0) ** k).item() > 0.0 for k in range(40))

    assert {name for name in TERMS if earns(name)} == earning


@every_term
def test_ground_that_shows_no_plane_is_treated_as_flat(env, name):
    term, _ = term_of(env, name)
    level, _ = term_of(env, name, slope=0.0)
    on_the_flat = values(env, level, 20.0, 60)
    env.height_scan = ground(20.0, valid=False)
    assert values(env, term, 20.0, 60).equal(on_the_flat)


# Nothing for standing still


@every_term
def test_who_stands_while_asked_to_walk_earns_nothing_however_good_the_posture(env, name):
    term, slope = term_of(env, name)
    assert values(env, term, slope, 100, speed=0.0).tolist() == [0.0] * 100


@every_term
def test_who_stops_soon_earns_nothing_whatever_is_remembered(env, name):
    term, slope = term_of(env, name)
    values(env, term, slope, 103)
    # Stopped in the middle of a step, one foot in the air for good, the joints at rest.
    stopped = torch.tensor([term(env).item() for env.signals in again(walking, 110, slope, speed=0.0, vel=0.0)])
    assert stopped[-1] < 0.005


@every_term
def test_walking_against_the_command_or_where_no_walking_is_asked_earns_nothing(env, name):
    term, slope = term_of(env, name)
    assert values(env, term, slope, 60, speed=-0.5).max() == 0.0
    env.commands = asking(0.0)
    assert values(env, term, slope, 60).max() == 0.0
    env.commands = asking(-0.5)
    assert values(env, term, slope, 60).max() == 0.0


@every_term
def test_walking_backward_where_that_is_asked_earns_as_much_as_forward(env, name):
    term, slope = term_of(env, name)
    forward = values(env, term, slope, 60)
    term, slope = term_of(env, name)
    env.commands = asking(-0.5)
    assert torch.equal(values(env, term, slope, 60, speed=-0.5), forward)


@every_term
def test_swaying_on_the_spot_earns_a_tenth_at_most(env, name):
    term, slope = term_of(env, name)
    swaying = []
    for k in range(150):  # 8 cm to and fro, once a second
        env.signals = walking(k, slope, speed=0.5 * math.sin(2.0 * math.pi * k * env.step_dt))
        swaying.append(term(env).item())
    assert torch.tensor(swaying)[100:].mean() < 0.1


@every_term
def test_only_posture_is_rewarded_in_worlds_that_are_asked_to_stand(env, name):
    term, slope = term_of(env, name)
    env.commands = asking(0.0, moving=False)
    earned = values(env, term, slope, 50, speed=0.0)
    if name == "com":
        assert earned.min() > 0.99
    else:
        assert earned.max() == 0.0


@every_term
def test_half_the_commanded_speed_earns_half(env, name):
    slow, slope = term_of(env, name)
    full, _ = term_of(env, name)
    one, half = values(env, full, slope, 140)[100:], values(env, slow, slope, 140, speed=0.25)[100:]
    torch.testing.assert_close(half, 0.5 * one, atol=0.02, rtol=0)


def test_sliding_downhill_on_both_feet_is_no_stride_and_no_braking(env):
    stride, slope = term_of(env, "stride")
    values(env, stride, slope, 60)
    sliding = values(env, stride, slope, 60, air=0, vel=0.0)
    assert sliding[40] > 0.8
    assert sliding[52:].max() == 0.0
    brake, slope = term_of(env, "brake")
    values(env, brake, slope, 60)
    sliding = values(env, brake, slope, 150, air=0, vel=0.0)
    assert sliding[0] > 0.5
    assert sliding[-1] < 0.05


def test_hops_and_running_steps_have_no_length(env):
    term, slope = term_of(env, "stride")
    for k in range(100):
        signals = walking(k, slope)
        signals.foot_force = torch.full((1, 2), WEIGHT if k % 20 < 5 else 0.0)
        env.signals = signals
        assert term(env).item() == 0.0


def test_chatter_of_a_standing_foot_is_no_touchdown(env):
    term, slope = term_of(env, "stride")
    values(env, term, slope, 100, apart=0.6)
    for k in range(40):  # now close together, one foot losing contact for three steps at a time
        signals = walking(0, slope, apart=0.0)
        signals.foot_force[0, 0] = 0.0 if k % 6 < 3 else WEIGHT
        env.signals = signals
        assert term(env).item() < 0.01


def test_a_foot_held_up_and_a_foot_in_the_air_with_the_other_are_no_swing(env):
    term, slope = term_of(env, "swing")
    hopping = values(env, term, slope, 120, air=0)  # lets progress settle
    assert hopping.max() == 0.0
    stork = torch.tensor([term(env).item() for env.signals in again(walking, 5, slope)])
    assert stork[:4].max() == 0.0  # not before 0.1 s
    assert stork[5:29].min() > 0.9
    assert stork[31:].max() == 0.0  # and not after 0.6 s
    values(env, term, slope, 3)
    for env.signals in again(walking, 5, slope):
        env.signals.foot_force = torch.zeros(1, 2)
        assert term(env).item() == 0.0


# Memory


@every_term
def test_a_reset_forgets_the_last_episode_of_its_worlds_alone(make_env, mask, name):
    def doubled(signals):
        return SimpleNamespace(
            **{
                key: value.repeat(2, *[1] * (value.dim() - 1))
                for key, value in vars(signals).items()
                if key != "along_ground"
            },
            along_ground=signals.along_ground,
        )

    env = make_env(2, robot=UNITREE_G1, commands=asking(0.5, 0.5))
    term, slope = term_of(env, name)
    cue = env.observers["slope_gait"]
    fresh, _ = term_of(env, name)
    env.height_scan = ground(slope, slope)
    for k in range(110):
        env.signals = doubled(walking(k, slope))
        before = term(env)
    for memory in (term, cue):
        memory.reset(mask(2, 1))
    env.signals = doubled(walking(110, slope))
    kept, anew = term(env).tolist()
    assert kept == pytest.approx(before[0].item(), rel=0.2)
    assert kept > 0.5
    assert anew == fresh(env)[1].item()
    assert anew < 0.1


def test_the_length_of_a_step_is_measured_as_the_foot_lands_and_holds_until_the_next_one(env):
    term, slope = term_of(env, "stride")
    values(env, term, slope, 120)
    longest = (0.5 * 0.4 + 0.05) * (1.0 - 0.25 * 20.0 / 30.0)
    lands = values(env, term, slope, 19, start=120, apart=longest + 0.05)  # lands in the last one
    assert lands[17] == pytest.approx(1.0, abs=0.03)
    assert lands[18] == pytest.approx(math.exp(-1.0), abs=0.03)
    held = values(env, term, slope, 19, start=139, apart=0.0)
    torch.testing.assert_close(held, torch.full_like(held, math.exp(-1.0)), atol=0.03, rtol=0)
    assert values(env, term, slope, 1, start=158, apart=0.0).item() == pytest.approx(1.0, abs=0.03)


def test_a_step_in_the_air_at_the_end_of_an_episode_does_not_land_in_the_next(env, mask):
    term, slope = term_of(env, "stride")
    values(env, term, slope, 115)  # one foot has been in the air for 0.24 s
    term.reset(mask(1, 0))
    for _ in range(200):
        env.signals = walking(0, slope)  # both feet down
        assert term(env).item() == 0.0


# The cue that all terms share


class Reference:
    """Every term with a progress average of its own, from the formulas of the paper and of `slope.bsga`."""

    def __init__(self, env):
        self.velocity, self.gain = env.zeros(2), 1.0 - math.exp(-env.step_dt / 0.5)
        triple = (bsga.HIP_PITCH, bsga.KNEE, bsga.ANKLE_PITCH)
        self.work = {sign: StanceWork(env, triple, sign, self.gain) for sign in ("positive", "negative")}
        self.air, self.swing = AirTime(env, 5.0), Swing(env, 5.0, 0.1, 0.6)
        self.length, self.age = env.zeros(), env.zeros() + math.inf
        self.knee, self.hip = (
            [NAMES.index(f"{side}_{j}_joint") for side in ("left", "right")] for j in ("knee", "hip_pitch")
        )

    def __call__(self, env):
        s, ground = env.signals, env.height_scan.descriptor
        command = env.commands.velocity[:, :2]
        asked = command.norm(dim=1)
        self.velocity = torch.lerp(self.velocity, s.root_lin_vel_t[:, :2], self.gain)
        along = (self.velocity * command).sum(dim=1) / asked.clamp(min=1e-6)
        progress = (along / asked.clamp(min=0.1)).clamp(0.0, 1.0) * (asked > 0.0)
        rho = (ground.slope.abs() / math.radians(30.0)).clamp(max=1.0)
        target = 0.69 * ground.slope.cos() + rho * (0.01 * ground.up + -0.03 * ground.down)
        com = torch.exp(-((s.com_height * ground.slope.cos() - target) / 0.10).square())
        hip = (self.work["positive"].share(env, 0) / (0.33 + 0.17 * rho)).clamp(max=1.0) * ground.up
        flexion = (0.45 + 0.30 * rho).unsqueeze(-1)
        posture = torch.exp(-((s.joint_pos[:, self.knee] - flexion) / 0.25).square())
        stance = (posture * s.foot_force).sum(dim=-1) / s.foot_force.sum(dim=-1).clamp(min=1.0)
        brake = stance * (self.work["negative"].share(env, 1) / 0.45).clamp(max=1.0) * ground.down
        before = self.air.steps
        carries = self.air.step(env)
        landed = (carries & (before >= 5) & (before.flip(1) == 0.0)).any(dim=1)
        apart = s.along_ground(s.foot_pos_w[:, 0] - s.foot_pos_w[:, 1])[:, 0].abs()
        self.length = torch.where(landed, apart, self.length)
        self.age = (self.age + 1).masked_fill(landed, 0.0)
        longest = (asked * 0.4 + 0.05) * (1.0 - 0.25 * rho)
        short = torch.exp((longest - self.length).clamp(max=0.0) / 0.05) * ground.down * (self.age <= 50)
        swings, q = self.swing.step(env), 0.45 + 1.0 * ground.slope.clamp(0.0, 30.0 * DEG)
        swing = (torch.exp(-((-s.joint_pos[:, self.hip] - q.unsqueeze(-1)) / 0.3).square()) * swings).sum(dim=-1)
        values = {"com": com, "hip": hip, "brake": brake, "stride": short, "swing": swing}
        standing = torch.where(env.commands.moving, progress, 1.0)
        return {name: value * (standing if name == "com" else progress) for name, value in values.items()}

    def reset(self, mask):
        for memory in (*self.work.values(), self.air, self.swing):
            memory.reset(mask)
        self.velocity = self.velocity.masked_fill(mask[:, None], 0.0)
        self.age = self.age.masked_fill(mask, math.inf)


@pytest.mark.parametrize("slope", [-20.0, 0.0, 20.0])
def test_terms_with_a_shared_cue_are_bit_for_bit_those_with_one_each(env, mask, slope):
    env.height_scan, env.observers = ground(slope), {"slope_gait": SlopeGait(env)}
    terms = {name: func(env, **params) for name, (func, params, _) in TERMS.items()}
    reference, earning = Reference(env), set()
    generator = torch.Generator().manual_seed(1)
    for k in range(160):
        speed, drive = (0.6 * torch.rand(2, generator=generator)).tolist()
        env.signals = walking(k, slope, speed=speed, drive=drive * (-1.0) ** (k // 7), apart=0.5 * speed)
        expected = reference(env)
        for name, term in terms.items():
            assert term(env).equal(expected[name]), (k, name)
            earning |= {name} if expected[name] > 0.0 else set()
        if k == 90:
            for memory in (*terms.values(), env.observers["slope_gait"], reference):
                memory.reset(mask(1, 0))
    assert earning == {"com", "swing"} | ({"hip"} if slope > 0.0 else {"brake", "stride"} if slope < 0.0 else set())


def test_one_parameter_of_the_cue_changes_all_terms_that_depend_on_it(env):
    def earned(**cue):
        found = set()
        for name, (func, params, slope) in TERMS.items():
            env.height_scan, env.observers = ground(slope), {"slope_gait": SlopeGait(env, **cue)}
            found.add((name, tuple(values(env, func(env, **params), slope, 50, apart=0.25).tolist())))
        return found

    usual = earned()
    assert {name for name, _ in usual - earned(memory_s=1.0)} == set(TERMS)
    assert {name for name, _ in usual - earned(full_slope=1.5)} == {"com", "hip", "brake", "stride"}


def test_the_cue_is_computed_once_a_step_for_all_terms(env, monkeypatch):
    env.height_scan, env.observers = ground(20.0), {"slope_gait": SlopeGait(env)}
    terms = [func(env, **params) for func, params, _ in TERMS.values()]
    calls = []
    progress = functions.progress
    monkeypatch.setattr(functions, "progress", lambda *args: calls.append(args) or progress(*args))
    for k in range(10):
        env.signals = walking(k, 20.0)
        for term in terms:
            term(env)
    assert len(calls) == 10


# The real robot on ramps


@pytest.fixture
def robot(pose):
    """robot(-20.0, knee=1.0, ...): the G1 that stands with both feet on a slope and walks along it at 0.5 m/s."""

    def make(slope, **angles):
        along = [0.5 * math.cos(slope * DEG), 0.0, 0.5 * math.sin(slope * DEG)]
        posed = pose(slope)
        posed.stand(**{name: a for part, a in angles.items() for name in NAMES if name.endswith(f"{part}_joint")})
        posed.put(root_lin_vel_w=along, foot_force_w={"left": [0.0, 0.0, WEIGHT / 2], "right": [0.0, 0.0, WEIGHT / 2]})
        posed.signals.refresh()
        return posed

    return make


def at_once(env):
    """A cue whose averages are as good as their last sample."""
    return {"slope_gait": SlopeGait(env, memory_s=1e-3)}


def score_of(env, func, posed, **params):
    env.height_scan, env.signals, env.observers = posed.height_scan, posed.signals, at_once(env)
    return func(env, **params)(env).item()


@pytest.mark.parametrize("slope", [-25.0, 0.0, 25.0])
def test_crouching_scores_lower_the_deeper_it_is_on_any_slope(env, robot, slope):
    def score(knee):
        posed = robot(slope, hip_pitch=-0.5 * knee, knee=knee, ankle_pitch=-0.5 * knee)
        return score_of(env, bsga.ComHeight, posed, nominal=0.69)

    upright = 0.75 if slope < 0.0 else 0.3
    scores = [score(knee) for knee in (upright, 1.1, 1.4, 1.7)]
    assert scores == sorted(scores, reverse=True)
    assert scores[0] > 0.98
    assert scores[-1] < 0.5


@pytest.mark.parametrize(("slope", "knee", "other"), [(25.0, 0.0, 0.75), (-25.0, 0.75, 0.0)])
def test_legs_nearly_straight_are_preferred_uphill_and_flexed_ones_downhill(env, robot, slope, knee, other):
    def score(knee):
        posed = robot(slope, hip_pitch=-0.5 * knee, knee=knee, ankle_pitch=-0.5 * knee)
        return score_of(env, bsga.ComHeight, posed, nominal=0.69)

    assert score(knee) > score(other) + 0.02


@pytest.mark.parametrize("slope", [5.0, 15.0, 30.0])
def test_the_more_the_hips_drive_uphill_the_better_up_to_the_target(env, robot, slope):
    def score(share):
        posed = robot(slope)
        power = joints(hip_pitch=60.0 * share, knee=60.0 * (1.0 - share) / 2, ankle_pitch=60.0 * (1.0 - share) / 2)
        posed.put_joints(vel=torch.ones(len(NAMES)), torque=power)
        posed.signals.refresh()
        return score_of(env, bsga.HipPropulsion, posed)

    scores = [score(share) for share in (0.0, 0.1, 0.2, 0.3)]
    assert scores == sorted(set(scores))
    assert score(0.33 + 0.17 * slope / 30.0) == pytest.approx(1.0, abs=0.01)


def test_negative_work_and_the_work_of_a_leg_in_the_air_propel_nothing(env, robot):
    def score(torque, left_force=WEIGHT / 2):
        posed = robot(20.0)
        posed.put(foot_force_w={"left": [0.0, 0.0, left_force]})
        posed.put_joints(vel=torch.ones(len(NAMES)), torque=torque)
        posed.signals.refresh()
        return score_of(env, bsga.HipPropulsion, posed)

    assert score(joints(hip_pitch=-50.0)) == 0.0
    assert score(joints(knee=30.0, left_hip_pitch=50.0), left_force=0.0) == 0.0
    assert score(joints(knee=30.0, left_hip_pitch=50.0)) > 0.8


@pytest.mark.parametrize("slope", [-5.0, -15.0, -30.0])
def test_a_more_flexed_braking_knee_is_better_downhill_up_to_the_target(env, robot, slope):
    def score(knee, share=0.6):
        posed = robot(slope, knee=knee)
        brakes = joints(knee=-60.0 * share, hip_pitch=-60.0 * (1.0 - share))
        posed.put_joints(vel=torch.ones(len(NAMES)), torque=brakes)
        posed.signals.refresh()
        return score_of(env, bsga.KneeBraking, posed)

    target = 0.45 - 0.30 * slope / 30.0
    scores = [score(knee) for knee in (0.0, 0.2, 0.4, target)]
    assert scores == sorted(set(scores))
    assert scores[-1] == pytest.approx(1.0, abs=0.01)
    assert score(target, share=0.2) == pytest.approx(0.2 / 0.45, abs=0.01)
    assert score(target + 0.5) < 0.1


@pytest.mark.parametrize("heading", [0.0, 40.0])
def test_stepping_further_than_the_speed_needs_costs_downhill_however_the_robot_faces(env, pose, heading):
    slope = -20.0
    turn = Rotation.from_euler("z", heading, degrees=True)
    ahead = turn.apply([math.cos(slope * DEG), 0.0, math.sin(slope * DEG)])

    def score(length):
        env.observers = at_once(env)
        term = bsga.Stride(env)
        posed = pose(slope, uphill=heading, root_quat_w=turn.as_quat(scalar_first=True), root_lin_vel_w=0.5 * ahead)
        left, right = length * ahead + turn.apply([0.0, 0.1, 0.0]), turn.apply([0.0, -0.1, 0.0])
        posed.put(foot_pos_w={"left": left, "right": right})
        env.height_scan, env.signals = posed.height_scan, posed.signals
        for lifted in [True] * 6 + [False]:
            posed.put(foot_force_w={"left": [0.0, 0.0, WEIGHT * (not lifted)], "right": [0.0, 0.0, WEIGHT]})
            posed.signals.refresh()
            value = term(env)
        return value.item()

    longest = (0.5 * 0.4 + 0.05) * (1.0 - 0.25 * 20.0 / 30.0)
    assert score(longest - 0.01) == pytest.approx(1.0, abs=1e-4)
    assert score(longest + 0.05) == pytest.approx(math.exp(-1.0), rel=1e-3)
    assert score(0.5) < 0.01


@pytest.mark.parametrize("name", TERMS)
def test_every_term_is_the_same_in_the_mirror(make_env, pose, name):
    generator = torch.Generator().manual_seed(3)
    index, sign = joint_image(UNITREE_G1)
    sideways = torch.tensor([1.0, -1.0, 1.0])
    _, _, slope = TERMS[name]
    other = {"left": "right", "right": "left"}

    def random(*shape, scale=1.0):
        return scale * (2.0 * torch.rand(*shape, generator=generator) - 1.0)

    def readings(step):
        carries = torch.tensor([[True, False], [False, True]])[step // 10 % 2]
        return {
            "com_pos_w": torch.tensor([0.0, 0.0, 0.65]) + random(3, scale=0.1),
            "root_quat_w": torch.tensor(
                Rotation.from_euler("zx", [20.0, 5.0], degrees=True).as_quat(scalar_first=True)
            ),
            "root_lin_vel_w": torch.tensor([0.4, 0.1, 0.4 * math.tan(slope * DEG)]),
            "foot_pos_w": {side: random(3, scale=0.15) for side in other},
            "foot_force_w": {
                side: (100.0 + random(3, scale=50.0)) * up for side, up in zip(other, carries, strict=True)
            },
        }, *(random(len(NAMES), scale=scale) for scale in (1.0, 3.0, 30.0))

    def image(key, value):
        if isinstance(value, dict):
            return {other[side]: image(key, v) for side, v in value.items()}
        if key == "root_quat_w":
            return value * torch.tensor([1.0, -1.0, 1.0, -1.0])
        return value * sideways

    here, there = pose(slope, uphill=15.0), pose(slope, uphill=-15.0)
    worlds = [
        make_env(1, robot=UNITREE_G1, commands=asking(0.5), signals=posed.signals, height_scan=posed.height_scan)
        for posed in (here, there)
    ]
    func, params, _ = TERMS[name]
    for world in worlds:
        world.observers = {"slope_gait": SlopeGait(world)}
    terms = [func(world, **params) for world in worlds]
    earned = []
    for step in range(35):
        put, pos, vel, torque = readings(step)
        here.put(**put)
        here.put_joints(vel, torque, pos)
        there.put(**{key: image(key, value) for key, value in put.items()})
        there.put_joints(vel[index] * sign, torque[index] * sign, pos[index] * sign)
        for posed in (here, there):
            posed.signals.refresh()
        one, mirrored = (term(world).item() for term, world in zip(terms, worlds, strict=True))
        assert one == pytest.approx(mirrored, abs=1e-5)
        earned.append(one)
    assert max(earned) > 0.05


# Mistakes


@pytest.mark.parametrize(
    ("term", "params", "message"),
    [
        (bsga.ComHeight, {"nominal": 0.0}, r"reward 'it': nominal is 0; it must be positive"),
        (bsga.Stride, {"std": -0.1}, r"reward 'it': std is -0\.1; it must be positive"),
        (bsga.HipPropulsion, {"cue": "gait"}, r"reward 'it': observer 'gait' is not a SlopeGait"),
        (bsga.SwingHip, {**SWING, "hip": "left_hip.*"}, r"one left and one right joint .* it matches left_hip_pitch_j"),
        (bsga.KneeBraking, {"knee": ".*_kne_joint"}, r"'\.\*_kne_joint' must match .* it matches nothing"),
        (bsga.KneeBraking, {"ankle": ".*ankle.*"}, r"it matches left_ankle_pitch_joint, left_ankle_roll_joint, right"),
    ],
)  # fmt: skip
def test_parameters_and_patterns_that_make_no_sense_are_refused(env, term, params, message):
    env.observers = {"slope_gait": SlopeGait(env), "gait": None}
    with pytest.raises(UserError, match=message):
        bind("reward", "it", RewardTermCfg(term, params), env)
