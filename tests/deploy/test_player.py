"""What walks by the contract alone walks as in the training environment."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from humoslope.deploy.contract import Contract, Steering, Timing
from humoslope.deploy.gait import Gait
from humoslope.deploy.player import Player, Summary, TouchdownCounter, Trial, TrialCfg, run_trials, steer, summarise
from humoslope.deploy.world import RUN_UP
from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.evaluation.ramps import RampProtocol, ramp_env_cfg
from humoslope.evaluation.ramps import run_trials as run_ramps
from humoslope.evaluation.ramps import summarise as summarise_ramps
from humoslope.export.policy import make_contract
from humoslope.learning import checkpoint
from humoslope.learning.configuration import trained_cfg
from humoslope.learning.policy import Actor, load_actor

WORLDS = 4


@pytest.fixture(scope="module")
def flat(stage1_checkpoint: Path) -> Callable[[float], tuple[ManagerBasedRlEnv, Actor, RampProtocol]]:
    """flat(seconds): the ramp check on flat ground, with random starts, for trials of that length."""

    def make(seconds: float) -> tuple[ManagerBasedRlEnv, Actor, RampProtocol]:
        protocol = RampProtocol(grades=(0.0,), starts=WORLDS, seconds=seconds)
        # As it was trained: today's task shows its actor older measurements.
        trained = trained_cfg(stage1_checkpoint, checkpoint.load(stage1_checkpoint))
        cfg = ramp_env_cfg(trained.env, protocol)
        cfg.sim.backend, cfg.sim.device = "native", "cpu"
        env = ManagerBasedRlEnv(cfg)
        return env, load_actor(stage1_checkpoint, env), protocol

    return make


def test_observations_and_motion_follow_the_training_environment_for_a_second(
    flat: Any, make_player: Callable[..., Player]
) -> None:
    """From the same states, by the same physics, with float64 observations and ONNX against float32 and torch.

    On flat ground the walk draws neighbouring states together, so that rounding does not grow: over 48 starts the
    joints came apart by about 1e-6 rad within a second and no more than 5e-6 within ten, for two policies.
    """
    env, actor, _ = flat(1.0)
    origin = torch.zeros(WORLDS, 3, dtype=torch.float64)
    origin[:, :2] = env.tiles.origin_w[:, :2]
    origin[:, 0] += env.tiles.spawn_x
    qpos = env.sim.state("qpos")
    states, observations = [], []
    for _ in range(50):
        obs = env.get_observations()
        states.append(torch.cat([qpos[:, :3] - origin, qpos[:, 3:]], dim=1).numpy())
        observations.append(obs["actor"].numpy())
        env.step(actor(obs))

    player = make_player()
    seen: list[Any] = []
    player.controller.observers["actor"] = Keep(player.controller.observers["actor"], seen)  # type: ignore[assignment]
    for world in range(WORLDS):
        player.start()
        data = player.world.data
        data.qpos[:] = states[0][world]
        mujoco.mj_forward(player.world.model, data)
        player.world._take_state()
        for step in range(50):
            np.testing.assert_allclose(data.qpos, states[step][world], atol=1e-4)
            player.step(player.course_command())
            np.testing.assert_allclose(seen[-1], observations[step][world], atol=1e-4)


@pytest.mark.parametrize(
    ("timestep", "age"), [(0.002, 0.01), (0.005, 0.01), (0.01, 0.01), (0.005, 0.013), (0.005, 0.03)]
)
def test_actions_are_those_of_the_environment_whatever_the_age_of_what_is_seen(
    make_stage1: Callable[..., ManagerBasedRlEnv],
    stage1_checkpoint: Path,
    make_player: Callable[..., Player],
    contract: Contract,
    timestep: float,
    age: float,
) -> None:
    """From the same start and on the same ground, also with an age between two physics steps or above a control step.

    Between two physics steps the environment interpolates the direction of gravity, the player the orientation.
    """

    def measure(cfg: EnvCfg) -> None:
        walk = ramp_env_cfg(cfg, RampProtocol(grades=(0.0,), starts=1, timestep=timestep))
        vars(cfg).update(vars(walk))
        cfg.sim.backend, cfg.sim.device, cfg.sim.observation_age_s = "native", "cpu", age
        for name, term in cfg.observations.actor.terms.items():
            if name not in ("velocity_command", "last_action"):
                term.params["measured"] = True

    env = make_stage1(1, measure)
    actor = load_actor(stage1_checkpoint, env)
    made = make_contract(actor, env, env.cfg, env.get_observations(), b"network", "<mujoco/>")
    assert made.timing == Timing(0.02, timestep, age)
    player = make_player(replace(contract, timing=made.timing))
    player.start()
    data, (qpos,) = player.world.data, env.sim.state("qpos").numpy()
    data.qpos[:] = qpos
    data.qpos[:2] -= env.tiles.origin_w[0, :2].numpy()
    data.qpos[0] -= env.tiles.spawn_x
    mujoco.mj_forward(player.world.model, data)
    player.world._take_state()
    largest = 0.0
    for _ in range(25):
        action = actor(env.get_observations())
        env.step(action)
        player.step(player.course_command())
        np.testing.assert_allclose(player.controller.last_action, action[0].numpy(), atol=1e-5)
        largest = max(largest, float(action.abs().max()))
    assert largest > 0.5


class Keep:
    """An observer that also keeps its results."""

    def __init__(self, observe: Any, seen: list[Any]) -> None:
        self._observe, self._seen, self.reset = observe, seen, observe.reset

    def __call__(self, measured: Any) -> Any:
        self._seen.append(self._observe(measured))
        return self._seen[-1]


def test_success_and_speed_on_flat_ground_are_those_of_the_ramp_check(
    flat: Any, make_player: Callable[..., Player]
) -> None:
    env, actor, protocol = flat(4.0)
    (checked,) = summarise_ramps(run_ramps(env, actor, protocol), protocol)
    played = summarise(list(run_trials(make_player(seconds=4.0, trials=WORLDS))))
    assert played.falls.low <= checked.falls.share <= played.falls.high
    assert played.speed == pytest.approx(checked.speed, abs=0.02)
    assert played.falls.count == checked.falls.count == 0


def test_it_climbs_and_descends(make_player: Callable[..., Player]) -> None:
    for grade in (20.0, -20.0):
        (done,) = run_trials(make_player(grade=grade, seconds=5.0))
        assert not done.fell
        assert done.distance > 1.5


def halved(contract: Contract) -> Contract:
    joints = tuple(replace(joint, action_scale_rad=0.5 * joint.action_scale_rad) for joint in contract.joints)
    return replace(contract, joints=joints)


def backwards(contract: Contract) -> Contract:
    return replace(contract, joints=contract.joints[::-1])


def test_it_does_not_walk_by_a_contract_that_says_something_else(
    make_player: Callable[..., Player], contract: Contract, with_terms: Callable[..., Contract]
) -> None:
    inverted = with_terms(gravity_direction={"scale": -1.0})
    for wrong in (halved(contract), backwards(contract), inverted):
        (done,) = run_trials(make_player(wrong, seconds=4.0))
        assert done.fell or done.distance < 1.0


def test_a_trial_is_the_same_alone_and_among_others(make_player: Callable[..., Player]) -> None:
    first, second = run_trials(make_player(seconds=0.5, trials=2))
    (alone,) = run_trials(make_player(seconds=0.5))
    assert alone.distance == first.distance != second.distance
    (other,) = run_trials(make_player(seconds=0.5, seed=1))
    assert other.distance != alone.distance
    assert math.isnan(alone.speed)  # nobody has settled
    assert summarise([alone]).speed is None


STEERING = Steering(
    "clamp(heading_gain_per_s * wrap(-lateral_gain_rad_m * place_left_of_course - yaw), +-limit_rad_s)", 0.5, 0.3, 0.25
)


@pytest.mark.parametrize(
    ("left", "yaw", "rate"),
    [
        (0.0, 0.0, 0.0),
        (0.5, 0.0, -0.075),
        (0.0, 0.2, -0.1),
        (0.0, -0.2, 0.1),
        (-1.0, 0.3, 0.0),
        (10.0, 0.0, -0.25),
        (0.0, 2.0 * math.pi + 0.2, -0.1),
    ],
)
def test_steering_leads_back_to_the_course(left: float, yaw: float, rate: float) -> None:
    assert steer(STEERING, left, yaw) == pytest.approx(rate)


def test_a_robot_that_is_asked_to_stand_is_not_asked_to_turn(make_player: Callable[..., Player]) -> None:
    player = make_player(speed=0.0)
    player.world.reset(y=0.5, yaw=0.3)
    np.testing.assert_array_equal(player.course_command(), np.zeros(3))


@pytest.mark.parametrize(
    ("course", "said"),
    [
        ({"grade": 61.0}, "--grade 61 must be between -60 and 60 degrees"),
        ({"grade": math.nan}, "--grade nan"),
        ({"speed": math.inf}, "--speed inf must be at most 10 m/s"),
        ({"seconds": 0.0}, "--seconds 0 must be positive"),
        ({"trials": 0}, "--trials 0 must be at least 1"),
        ({"seed": -1}, "--seed -1 at least 0"),
    ],
)
def test_an_impossible_course_is_refused(course: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said):
        TrialCfg(**course)


# Standing: creep, drift and steps.


@given(
    off=st.lists(st.tuples(st.booleans(), st.booleans()), max_size=60),
    dt=st.sampled_from([0.005, 0.02, 0.05]),
)
def test_a_touchdown_is_a_contact_after_a_swing(off: list[tuple[bool, bool]], dt: float) -> None:
    counter = TouchdownCounter(2, dt)
    for sample in off:
        counter.add(np.array(sample))
    least = {0.005: 12, 0.02: 3, 0.05: 1}[dt]  # samples in 0.06 s
    expected = 0
    for foot in (0, 1):
        word = "".join("d" if sample[foot] else "u" for sample in off)
        expected += sum(len(swing) >= least for swing in re.findall(r"u+(?=d)", word))
    assert counter.count == expected


@pytest.mark.parametrize("grade", [0.0, -30.0])
def test_drift_and_creep_are_measured_on_the_ground_and_steps_after_settling(
    make_player: Callable[..., Player], monkeypatch: pytest.MonkeyPatch, grade: float
) -> None:
    """A robot that is carried: 0.1 m/s ahead and 0.2 m/s to the right, with a step of one foot every 0.5 s."""
    player = make_player(grade=grade, speed=0.0, seconds=6.0)
    world, steps = player.world, 0

    def carry(command: Any) -> None:
        nonlocal steps
        np.testing.assert_array_equal(command, np.zeros(3))
        steps += 1
        time = steps * 0.02
        world._seen_pos[:3] = start + np.array([0.1 * math.cos(math.radians(grade)), -0.2, 0.0]) * time
        world._seen_pos[2] = world.ground(world._seen_pos[0]) + 0.75

    start = np.array([RUN_UP, 0.0, 0.75])  # where a ramp begins
    monkeypatch.setattr(player, "start", lambda rng: world._seen_pos.__setitem__(slice(0, 3), start))
    monkeypatch.setattr(player, "step", carry)
    monkeypatch.setattr(world, "feet_down", lambda: np.array([True, steps % 25 >= 10]))
    (trial,) = run_trials(player)
    assert not trial.fell
    assert trial.drift == pytest.approx(6.0 * math.hypot(0.1, 0.2))
    assert trial.creep == pytest.approx(math.hypot(0.1, 0.2))
    assert trial.speed == pytest.approx(0.1)
    assert trial.step_rate == pytest.approx(2.0)


def test_a_fall_ends_what_is_measured(make_player: Callable[..., Player], monkeypatch: pytest.MonkeyPatch) -> None:
    player = make_player(speed=0.0, seconds=6.0)
    monkeypatch.setattr(player.world, "fallen", lambda: player.world.data.time > 2.999)
    (trial,) = run_trials(player)
    assert trial.fell
    assert trial.seconds == pytest.approx(3.0)
    assert trial.creep > 0.0
    monkeypatch.setattr(player.world, "fallen", lambda: player.world.data.time > 1.999)
    (trial,) = run_trials(player)
    assert trial.seconds == pytest.approx(2.0)
    assert math.isnan(trial.creep)
    assert math.isnan(trial.step_rate)
    together = summarise([trial])
    assert (together.creep, together.step_rate, together.falls.count) == (None, None, 1)


def test_the_shipped_policy_marks_time_where_it_is_asked_to_stand(make_player: Callable[..., Player]) -> None:
    """Its contract says that it was trained with commands to stand; that it stands still would not be true."""
    player = make_player(speed=0.0, seconds=8.0, trials=2)
    assert player.contract.commands.trained_to_stand
    result = summarise(list(run_trials(player)))
    assert result.falls.count == 0
    assert result.creep == pytest.approx(0.07, abs=0.04)
    assert result.step_rate == pytest.approx(4.0, abs=0.5)
    assert result.drift > 0.2


def test_a_summary_is_the_mean_over_what_was_measured() -> None:
    trials = [
        Trial(False, 4.0, 1.0, 0.5, 2.0, 0.1, 3.0, 0.2, 0.5, -0.1, Gait(0.0, 0.1, math.nan, 0.3)),
        Trial(True, 1.0, 2.0, math.nan, 4.0, *[math.nan] * 5, Gait(*[math.nan] * 4)),
    ]
    result = summarise(trials)
    assert replace(result, gait=trials[0].gait) == Summary(
        result.falls, 0.5, 1.5, 3.0, 0.1, 3.0, 0.2, -0.1, trials[0].gait
    )
    assert (result.gait.self_contact, result.gait.double_support, result.gait.fast_share) == (0.0, 0.1, 0.3)
    assert math.isnan(result.gait.knee_flexion)
    assert (result.falls.count, result.falls.total) == (1, 2)
