"""A recording holds what happened."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.managers import EventTermCfg, Terms
from humoslope.managers.terms import StatefulTerm
from humoslope.mdp.zmp import ZmpRegulariser
from humoslope.registry import build_task
from humoslope.replay.record import RecordProtocol, record, record_env_cfg
from humoslope.replay.rollout import Rollout
from terrains.profiles import APPROACH

FALL_WEIGHT, ALIVE_WEIGHT = -100.0, 0.15


def rewards(rollout: Rollout, name: str) -> np.ndarray:
    return rollout.columns.reward[:, rollout.header["reward_terms"].index(name)]


def test_there_is_a_row_for_every_control_step(rollout: Rollout) -> None:
    assert len(rollout.columns) == 200
    np.testing.assert_allclose(np.diff(rollout.columns.time), 0.02, atol=1e-5)
    assert rollout.columns.time[-1] == pytest.approx(4.0)


def test_a_fall_is_recorded_as_it_is_and_the_robot_starts_anew_after_it(rollout: Rollout) -> None:
    columns = rollout.columns
    falls = [event for event in rollout.events if event.kind == "fall"]
    assert falls
    for event in falls:
        row = round(event.time / 0.02) - 1
        _, x, y, _ = columns.root_quat_w[row]
        tilt = math.degrees(math.acos(1.0 - 2.0 * (x**2 + y**2)))
        assert tilt > 54.0 or columns.root_height[row] < 0.41
        if row + 1 < len(columns):
            assert columns.episode[row + 1] == columns.episode[row] + 1
            assert columns.root_height[row + 1] > 0.7
    np.testing.assert_array_equal(np.flatnonzero(rewards(rollout, "fall")), [round(e.time / 0.02) - 1 for e in falls])


def test_rewards_are_weighted_and_per_second(rollout: Rollout) -> None:
    np.testing.assert_allclose(rewards(rollout, "alive"), ALIVE_WEIGHT)
    assert rewards(rollout, "fall").min() == pytest.approx(FALL_WEIGHT)


def test_pushes_come_when_and_as_hard_as_was_asked(rollout: Rollout) -> None:
    pushes = [event for event in rollout.events if event.kind == "push"]
    assert [push.time for push in pushes] == pytest.approx([0.9, 1.8, 2.7, 3.6])
    for push in pushes:
        size, angle = re.fullmatch(r"push of ([0-9.]+) m/s towards (-?[0-9]+)°", push.text).groups()
        assert 0.0 < float(size) <= 1.5 * math.sqrt(2.0)
        before = round(push.time / 0.02) - 1
        jump = np.diff(rollout.columns.root_lin_vel_w[before : before + 2, :2], axis=0)[0]
        along = jump @ (math.cos(math.radians(float(angle))), math.sin(math.radians(float(angle))))
        assert along == pytest.approx(float(size), abs=0.4)  # feet answer within a control step


def test_the_zero_moment_point_lies_on_the_support_plane_and_the_anchor_at_the_feet(rollout: Rollout) -> None:
    c = rollout.columns
    assert c.zmp_valid.mean() > 0.5
    off_plane = ((c.zmp_w - c.zmp_anchor_w) * c.zmp_normal_w).sum(axis=1)
    np.testing.assert_allclose(off_plane, 0.0, atol=1e-4)
    np.testing.assert_array_equal(c.zmp_w[~c.zmp_valid], c.zmp_anchor_w[~c.zmp_valid])
    reach = np.linalg.norm(c.foot_pos_w[:, 0] - c.foot_pos_w[:, 1], axis=1)
    assert (np.linalg.norm(c.zmp_anchor_w - c.foot_pos_w[:, 0], axis=1) <= reach + 1e-4).all()


def test_the_ground_is_that_of_the_ramp_ahead(rollout: Rollout) -> None:
    terrain, heights = rollout.header["terrain"], rollout.terrain_heights
    assert (terrain["name"], terrain["grade"]) == ("ramp-up", 20.0)
    start = round((terrain["tile_origin"][0] - terrain["origin"][0]) / terrain["cell"])
    middle = heights[start:, heights.shape[1] // 2]
    at = round(APPROACH / terrain["cell"])
    np.testing.assert_allclose(np.diff(middle[at : at + 50]), 0.1 * math.tan(math.radians(20.0)), atol=1e-5)
    assert rollout.columns.slope[0] == pytest.approx(0.0, abs=0.1)
    assert rollout.columns.ground_normal_w[0, 2] > 0.99


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_slope_bank_and_normal_are_those_of_the_ground_under_the_robot(walk: Callable[..., Rollout], seed: int) -> None:
    """On a plane that rises in a direction of its own."""
    protocol = RecordProtocol(terrain="hillside", grade=20.0, seconds=0.04, seed=seed)
    rollout = walk("HumoSlope-Stage1-Unitree-G1", protocol)
    c, terrain = rollout.columns, rollout.header["terrain"]
    x, y = (round((c.root_pos_w[0, i] - terrain["origin"][i]) / terrain["cell"]) for i in (0, 1))
    around = rollout.terrain_heights[x - 4 : x + 5, y - 4 : y + 5]
    rise = [float(np.diff(around, axis=axis).mean()) / terrain["cell"] for axis in (0, 1)]
    assert math.hypot(*rise) == pytest.approx(math.tan(math.radians(20.0)), rel=1e-3)
    np.testing.assert_allclose(
        c.ground_normal_w[0], np.array([-rise[0], -rise[1], 1.0]) * math.cos(math.radians(20.0)), atol=0.01
    )
    w, _, _, z = c.root_quat_w[0]
    yaw = 2.0 * math.atan2(z, w)
    ahead = rise[0] * math.cos(yaw) + rise[1] * math.sin(yaw)
    left = rise[1] * math.cos(yaw) - rise[0] * math.sin(yaw)
    assert c.slope[0] == pytest.approx(math.atan(ahead), abs=0.02)
    assert c.bank[0] == pytest.approx(math.atan(left), abs=0.02)
    assert (c.uphill[0], c.downhill[0]) == (c.slope[0] > 0.05, c.slope[0] < -0.05)


def test_only_a_task_that_asks_for_a_com_height_has_a_target(rollout: Rollout, walk: Callable[..., Rollout]) -> None:
    assert np.isnan(rollout.columns.com_height_target).all()
    second = walk("HumoSlope-Stage2-Unitree-G1", RecordProtocol(terrain="flat", seconds=0.2))
    np.testing.assert_allclose(second.columns.com_height_target, 0.69, atol=1e-4)


def test_neither_noise_nor_harness_nor_randomisation_is_left() -> None:
    cfg = record_env_cfg(build_task("HumoSlope-Stage1-Unitree-G1").env, RecordProtocol())
    assert [name for name, _ in cfg.events.items()] == ["friction", "root", "joints"]
    assert not cfg.observations.actor.enable_corruption
    assert cfg.sim.cone == "elliptic"
    assert cfg.sim.timestep == 0.005


@pytest.mark.parametrize(("terrain", "grade"), [("held-out-track", 20.0), ("rough-ramp-up", 30.0), ("ramp-down", 30.0)])
def test_the_friction_is_what_the_protocol_says_on_any_ground(terrain: str, grade: float) -> None:
    """Not what the steepest place of a tile would need, which on the track is the edge of its twisted bank."""
    protocol = RecordProtocol(terrain=terrain, grade=grade)
    env = ManagerBasedRlEnv(record_env_cfg(build_task("HumoSlope-Stage1-Unitree-G1").env, protocol))
    mu = max(0.8, math.tan(math.radians(abs(grade))) + 0.3)
    assert protocol.coefficient == pytest.approx(mu)
    feet = [env.sim.model.geom(name).id for side in env.robot.foot_geoms for name in side]
    np.testing.assert_allclose(env.sim.expand("geom_friction")[0, feet, 0], mu, rtol=1e-6)


def test_a_walk_may_be_longer_than_a_ramp_and_is_refused_in_its_own_name() -> None:
    task = build_task("HumoSlope-Stage1-Unitree-G1").env
    cfg = record_env_cfg(task, RecordProtocol(terrain="held-out-track", seconds=1000.0))
    assert cfg.episode_length_s > 1000.0
    with pytest.raises(UserError, match="record: "):
        record_env_cfg(task, RecordProtocol(timestep=0.003))


def test_a_recording_without_a_step_is_refused() -> None:
    protocol = RecordProtocol(seconds=0.008)
    env = ManagerBasedRlEnv(record_env_cfg(build_task("HumoSlope-Stage1-Unitree-G1").env, protocol))
    with pytest.raises(UserError, match="record: seconds is 0.008 s; it must be finite and at least one control step"):
        record(env, lambda obs: torch.zeros(1, 29), protocol)


def test_the_ground_is_long_enough_for_a_robot_that_is_half_as_fast_again() -> None:
    assert RecordProtocol(seconds=60.0, speed=0.5).ground().tile_length >= 1.5 * 60.0 * 0.5
    assert RecordProtocol(seconds=1.0).ground().tile_length == 10.0


def test_the_held_out_track_is_walked_as_it_is_and_its_segments_are_events(walk: Callable[..., Rollout]) -> None:
    rollout = walk("HumoSlope-Stage1-Unitree-G1", RecordProtocol(terrain="held-out-track", grade=10.0, seconds=0.1))
    terrain = rollout.header["terrain"]
    assert (terrain["tile_length"], terrain["cell"]) == (35.0, 0.05)
    assert [event.text for event in rollout.events] == ["start"]


def test_the_usual_grade_is_20_degrees_or_the_nearest_that_there_is() -> None:
    assert RecordProtocol(terrain="ramp-up").resolve_grade() == 20.0
    assert RecordProtocol(terrain="flat").resolve_grade() == 0.0
    assert RecordProtocol(terrain="ramp-up", level=0.5).resolve_grade() == 16.0


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"grade": 10.0, "level": 0.5}, "not both"),
        ({"level": 1.5}, "level is 1.5; it must be between 0 and 1"),
        ({"seconds": 0.0}, "seconds is 0"),
        ({"push": -1.0}, "push is -1"),
        ({"terrain": "ramp-upp"}, "did you mean 'ramp-up'"),
        ({"grade": 50.0}, "grade 50 must be between 0 and 32"),
    ],
)
def test_an_impossible_protocol_is_said_in_one_sentence(wrong: dict[str, object], said: str) -> None:
    with pytest.raises(UserError, match=said):
        RecordProtocol(**wrong).ground()


# Recording observes; it takes no part.

KICKS = {10: (0.3, -0.2), 25: (0.0, 0.5), 40: (-0.1, 0.0)}
"""Changes of velocity, m/s, by control step."""


class Kick(StatefulTerm):
    """Step event that changes the velocity of the root at the steps in `KICKS`."""

    def __init__(self, env: Any) -> None:
        self.step = 0

    def __call__(self, env: Any, mask: Any) -> None:
        self.step += 1
        if self.step in KICKS:
            env.sim.state("qvel")[0, :2] += torch.tensor(KICKS[self.step])

    def reset(self, mask: Any) -> None:
        pass


def kicked(change: Callable[[EnvCfg], None] = lambda cfg: None) -> tuple[ManagerBasedRlEnv, RecordProtocol]:
    protocol = RecordProtocol(terrain="flat", seconds=1.0)
    cfg = record_env_cfg(build_task("HumoSlope-Stage1-Unitree-G1").env, protocol)
    cfg.sim.backend = "native"
    cfg.events.kick = EventTermCfg(Kick, mode="step")
    change(cfg)
    return ManagerBasedRlEnv(cfg), protocol


def still(env: ManagerBasedRlEnv) -> Callable[[Any], torch.Tensor]:
    return lambda obs: torch.zeros(1, env.robot.num_joints)


def test_a_change_of_velocity_by_any_event_is_a_push() -> None:
    env, protocol = kicked()
    pushes = [event for event in record(env, still(env), protocol).events if event.kind == "push"]
    assert [push.time for push in pushes] == pytest.approx([0.2, 0.5, 0.8])
    assert [push.text for push in pushes] == [
        "push of 0.36 m/s towards -34°",
        "push of 0.50 m/s towards 90°",
        "push of 0.10 m/s towards 180°",
    ]


def test_a_push_of_a_robot_that_falls_in_the_same_step_is_none() -> None:
    """The reset takes it back."""

    def fall_at_once(cfg: EnvCfg) -> None:
        cfg.terminations.root_too_low.params["height"] = 2.0

    env, protocol = kicked(fall_at_once)
    kinds = [event.kind for event in record(env, still(env), protocol).events]
    assert kinds.count("fall") == 50
    assert "push" not in kinds


def test_recording_changes_nothing_that_is_recorded() -> None:
    env, protocol = kicked()
    rollout = record(env, still(env), protocol)
    alone, _ = kicked()
    with torch.inference_mode():
        for _ in range(50):
            alone.step(still(alone)(None))
    np.testing.assert_array_equal(rollout.columns.joint_pos[-1], alone.signals.joint_pos[0].numpy())
    np.testing.assert_array_equal(rollout.columns.root_pos_w[-1], alone.signals.root_pos_w[0].numpy())


def test_an_env_without_rewards_is_recorded() -> None:
    def without(cfg: EnvCfg) -> None:
        cfg.rewards = Terms()

    env, protocol = kicked(without)
    rollout = record(env, still(env), protocol)
    assert rollout.columns.reward.shape == (50, 0)
    assert rollout.header["reward_terms"] == []


def test_every_group_that_the_policy_reads_is_kept_without_noise() -> None:
    task = build_task("HumoSlope-Stage1-Unitree-G1").env
    cfg = record_env_cfg(task, RecordProtocol(), groups=("critic", "actor"))
    assert [name for name, _ in cfg.observations.items()] == ["critic", "actor"]
    assert not any(group.enable_corruption for _, group in cfg.observations.items())
    assert task.observations.actor.enable_corruption
    assert [name for name, _ in record_env_cfg(task, RecordProtocol()).observations.items()] == ["actor"]
    with pytest.raises(UserError, match="'terrain' does not exist"):
        record_env_cfg(task, RecordProtocol(), groups=("actor", "terrain"))


def test_the_support_plane_is_that_of_the_regulariser_of_the_task() -> None:
    """Row by row the columns are what a fresh regulariser gives, which forgets at every fall."""

    def fall_often(cfg: EnvCfg) -> None:
        cfg.terminations.root_too_low.params["height"] = 0.745

    env, protocol = kicked(fall_often)
    term = ZmpRegulariser(env, **env.cfg.rewards.zmp.params)
    expected = []

    def observe(env: Any) -> None:
        term(env)
        expected.append(torch.cat([term.point[0], term.normal[0]]).clone())
        term.reset(env.terminations.terminated | env.terminations.time_outs)

    env.observers.append(observe)
    columns = record(env, still(env), protocol).columns
    assert columns.episode[-1] > 0
    found = np.concatenate([columns.zmp_w, columns.zmp_normal_w], axis=1)
    np.testing.assert_array_equal(found, torch.stack(expected).numpy())
