"""The ramp check measures every policy on the same ground, under the same conditions."""

from __future__ import annotations

import dataclasses
import math
from types import MethodType
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.evaluation.ramp_trials import Trials
from humoslope.evaluation.ramps import (
    APPROACH,
    RampProtocol,
    RampResult,
    along_course,
    ramp_env_cfg,
    run_trials,
    summarise,
    table,
)
from humoslope.presets import apply_preset
from humoslope.provenance import plain
from humoslope.registry import build_task
from humoslope.slope import quaternion

SMALL = RampProtocol(grades=(0.0, 25.0, -30.0), starts=2, seconds=3.0)


def stage1_env() -> EnvCfg:
    cfg = build_task("HumoSlope-Stage1-Unitree-G1")
    apply_preset(cfg, "cpu")
    return cfg.env


@pytest.fixture(scope="module")
def env() -> ManagerBasedRlEnv:
    cfg = ramp_env_cfg(stage1_env(), SMALL)
    cfg.sim.backend = "native"
    return ManagerBasedRlEnv(cfg)


def standing(count: int, **changes: Any) -> Trials:
    """Trials of robots that walked 7 m in 20 s at 0.35 m/s."""
    full = {
        "fell": np.zeros(count, dtype=bool),
        "left": np.zeros(count, dtype=bool),
        "seconds": np.full(count, 20.0),
        "start": np.full(count, 0.75),
        "end": np.full(count, 7.75),
        "samples": np.full(count, 900.0),
        "speed": np.full(count, 0.35),
        "measured_s": np.full(count, 18.0),
        "squared_error": np.full(count, 900.0 * 0.15**2),
        "lateral": np.full(count, 0.05),
        "yaw_rate": np.full(count, 0.1),
        "height": np.full(count, 0.77),
        "creep": np.tile([0.35, 0.05], (count, 1)),
        "drift": np.tile([6.3, 0.4], (count, 1)),
        "touchdowns": np.full(count, 2.5),
        "self_contact": np.full(count, 0.25),
    }
    return Trials(**{**full, **changes})


def test_training_aids_and_disturbances_are_gone_and_the_task_is_left_as_it_was() -> None:
    task = stage1_env()
    cfg = ramp_env_cfg(task, SMALL)
    assert list(dict(cfg.events.items())) == ["friction", "root", "joints"]
    assert len(cfg.curriculum) == len(cfg.rewards) == 0
    assert list(dict(cfg.observations.items())) == ["actor"]
    assert not cfg.observations.actor.enable_corruption
    assert task.observations.actor.enable_corruption
    assert "harness" in task.events
    assert "push" in task.events


def test_physics_is_fine_and_elliptic_while_the_policy_keeps_its_pace() -> None:
    task = stage1_env()
    cfg = ramp_env_cfg(task, SMALL)
    assert (task.sim.timestep, task.sim.decimation) == (0.01, 2)
    assert (cfg.sim.timestep, cfg.sim.decimation, cfg.sim.cone) == (0.005, 4, "elliptic")


def test_worlds_stand_on_their_grades_and_are_asked_to_walk_straight(env: ManagerBasedRlEnv) -> None:
    assert env.num_envs == 6
    assert env.commands.velocity[:, 0].tolist() == [0.5] * 6
    assert env.commands._steers.all()
    x = torch.tensor([APPROACH, APPROACH + 1.0])[None, :].expand(6, 2) + env.tiles.origin_w[:, :1]
    y = env.tiles.origin_w[:, 1:2].expand(6, 2)
    height = env.terrain.height(torch.stack([x, y], dim=2))
    rise = torch.rad2deg(torch.atan(height[:, 1] - height[:, 0]))
    np.testing.assert_allclose(rise, [0.0, 0.0, 25.0, 25.0, -30.0, -30.0], atol=1e-3)


def test_feet_have_the_friction_that_is_reported(env: ManagerBasedRlEnv) -> None:
    field = env.sim.expand("geom_friction")
    for side in env.robot.foot_geoms:
        for geom in side:
            mu = field[:, env.sim.model.geom(geom).id, 0]
            expected = [SMALL.friction_on(g) for g in SMALL.grades for _ in range(SMALL.starts)]
            np.testing.assert_allclose(mu, expected, atol=1e-6)
    assert SMALL.friction_on(0.0) == 0.8
    assert SMALL.friction_on(-30.0) == pytest.approx(math.tan(math.radians(30.0)) + 0.3)


def test_a_robot_that_only_holds_its_pose_falls_and_is_counted_once(env: ManagerBasedRlEnv) -> None:
    steps: list[None] = []
    trials = run_trials(env, lambda _: env.zeros(env.robot.num_joints), SMALL, lambda: steps.append(None))
    assert len(steps) == 150
    results = summarise(trials, SMALL)
    assert [r.grade for r in results] == list(SMALL.grades)
    assert all(r.falls.count == r.falls.total == 2 for r in results)
    assert all(r.seconds < SMALL.seconds for r in results)


def test_figures_belong_to_the_grade_they_were_measured_on() -> None:
    protocol = dataclasses.replace(SMALL, starts=4, seconds=20.0)
    fell = np.zeros(12, dtype=bool)
    fell[[4, 5, 6, 11]] = True
    left = np.zeros(12, dtype=bool)
    left[7] = True
    flat, up, down = summarise(standing(12, fell=fell, left=left), protocol)
    assert (flat.falls.count, up.falls.count, down.falls.count) == (0, 3, 1)
    assert (flat.left_course, up.left_course, down.left_course) == (0, 1, 0)
    assert flat.speed == pytest.approx(0.35)
    assert flat.speed_error == pytest.approx(0.15)
    assert flat.speed_rms_error == pytest.approx(0.15)
    assert flat.root_height == pytest.approx(0.77)
    assert flat.self_contact == pytest.approx(0.25)
    assert flat.distance == pytest.approx(7.0)
    assert up.distance == pytest.approx(0.75 + 6.25 / math.cos(math.radians(25.0)))


@given(grade=st.floats(-60, 60), x=st.floats(0, 20), step=st.floats(0, 5))
def test_way_on_a_ramp_is_the_hypotenuse(grade: float, x: float, step: float) -> None:
    start, end = along_course(np.array([x, x + step]), grade)
    assert end - start >= step - 1e-9
    if x >= APPROACH:
        assert end - start == pytest.approx(math.hypot(step, step * math.tan(math.radians(grade))), abs=1e-9)


def test_no_number_is_cut_off_in_a_narrow_terminal() -> None:
    protocol = dataclasses.replace(SMALL, starts=512)
    console = Console(width=80)
    with console.capture() as captured:
        console.print(
            table(summarise(standing(1536, fell=np.ones(1536, dtype=bool), end=np.full(1536, 15.0)), protocol))
        )
    assert "512/512" in captured.get()
    assert "…" not in captured.get()


def test_the_table_runs_from_the_steepest_way_down_to_the_steepest_way_up() -> None:
    console = Console(width=80)
    with console.capture() as captured:
        console.print(table(summarise(standing(6), SMALL)))
    rows = [line.split() for line in captured.get().splitlines() if "0/2" in line]
    assert [row[0] for row in rows] == ["-30", "0", "+25"]
    assert rows[0][1:] == ["0/2", "0.0", "0.0-65.8", "0", "0.350", "0.150", "0.150", "0.770", rows[0][-2], "25.0"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"grades": ()}, "grades is \\(\\); it must have at least one"),
        ({"grades": (0.0, 90.0)}, "grades is .* of each, it must be between -60 and 60 \\(too high\\)"),
        ({"grades": (float("nan"),)}, "of each, it must be between -60 and 60 \\(not finite\\)"),
        ({"starts": 0}, "starts is 0"),
        ({"speed": math.nan}, "speed is nan; it must be a finite number"),
        ({"yaw_rate": math.inf}, "yaw_rate is inf; it must be a finite number"),
        ({"speed": 0.0, "lateral": 9.0}, "9 m/s for 20 s needs .* m of ground; there are at most 200 m"),
        ({"push": -1.0}, "push is -1; it must be 0 or more"),
        ({"push_every": 0.0}, "push_every is 0; it must be positive"),
        ({"seconds": -1.0}, "seconds is -1"),
        ({"seconds": float("inf")}, "seconds is inf"),
        ({"seconds": 1e6}, "at most 200 m"),
        ({"friction": -0.1}, "friction is -0.1"),
        ({"friction_margin": float("nan")}, "friction_margin is nan"),
    ],
)
def test_an_impossible_protocol_is_refused_in_one_sentence(change: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=said) as caught:
        RampProtocol(**change)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("timestep", [0.003, 0.05])
def test_a_physics_step_must_divide_the_control_step(timestep: float) -> None:
    with pytest.raises(UserError, match=f"timestep {timestep:g} s does not divide"):
        ramp_env_cfg(stage1_env(), RampProtocol(timestep=timestep))


def test_a_fall_is_the_same_for_every_task_and_for_stage_1_what_its_training_took_for_one() -> None:
    other = ramp_env_cfg(build_task("URL-Literal-Unitree-G1").env, SMALL)
    ours = ramp_env_cfg(stage1_env(), SMALL)
    assert plain(other.terminations) == plain(ours.terminations) == plain(stage1_env().terminations)


def test_every_group_that_the_policy_reads_is_kept_without_noise() -> None:
    task = stage1_env()
    cfg = ramp_env_cfg(task, SMALL, ("actor", "critic"))
    assert list(dict(cfg.observations.items())) == ["actor", "critic"]
    assert not any(group.enable_corruption for _, group in cfg.observations.items())
    with pytest.raises(UserError, match="observation group 'acter' does not exist; did you mean 'actor'"):
        ramp_env_cfg(task, SMALL, ("acter",))


# A robot that is commanded to stand

STAND = RampProtocol(grades=(0.0, 15.0, -15.0), starts=2, seconds=3.0, speed=0.0)


@pytest.fixture(scope="module")
def standing_env() -> ManagerBasedRlEnv:
    cfg = ramp_env_cfg(stage1_env(), STAND)
    cfg.sim.backend = "native"
    return ManagerBasedRlEnv(cfg)


def test_at_speed_zero_the_command_is_to_stand_and_the_robot_starts_on_the_slope(
    standing_env: ManagerBasedRlEnv,
) -> None:
    env = standing_env
    assert not env.commands.moving.any()
    env.sim.state("qpos")[:, 1] += 0.5  # off the centre line: a robot that steers would turn
    env.signals.refresh()
    env.commands.step()
    assert env.commands.velocity.abs().max() == 0.0
    np.testing.assert_allclose(torch.rad2deg(_grade_below(env)), GRADES_OF_STAND, atol=0.01)
    env.sim.state("qpos")[:, 1] -= 0.5
    env.signals.refresh()
    x = env.signals.root_pos_w[:, 0] - env.tiles.origin_w[:, 0]
    assert (x - 0.5 * STAND.tile_length).abs().max() <= 0.15 + 1e-5
    assert STAND.tile_length >= 2.0 * (0.5 * STAND.seconds + 0.3)


GRADES_OF_STAND = [0.0, 0.0, 15.0, 15.0, -15.0, -15.0]


def _grade_below(env: ManagerBasedRlEnv) -> torch.Tensor:
    xy = env.signals.root_pos_w[:, :2]
    ahead = torch.tensor([0.5, 0.0])
    return torch.atan(env.terrain.height(xy + ahead) - env.terrain.height(xy - ahead))


def glide(env: ManagerBasedRlEnv, along: float, across: float, turn: float = 0.0) -> None:
    """Replaces the physics: robots glide over the ground at these horizontal speeds and turn at this rate, rad/s."""
    yaw = torch.zeros(env.num_envs, dtype=torch.float64)

    def carry(sim: object, n: int, mask: torch.Tensor | None) -> None:
        qpos = env.sim.state("qpos").clone()
        passed = n * env.cfg.sim.timestep
        qpos[:, 0] += along * passed
        qpos[:, 1] += across * passed
        ground = env.terrain.height(qpos[:, :2].float())
        ahead = env.terrain.height(qpos[:, :2].float() + 0.1 * torch.tensor([along, across]))
        qpos[:, 2] = ground + env.robot.default_root_height + 0.2
        yaw.add_(turn * passed)
        qpos[:, 3:7] = quaternion.from_yaw(yaw)
        qvel = torch.zeros_like(env.sim.state("qvel"))
        qvel[:, 0], qvel[:, 1], qvel[:, 2], qvel[:, 5] = along, across, (ahead - ground) / 0.1, turn
        env.sim.reset(torch.ones(env.num_envs, dtype=torch.bool), qpos, qvel)

    env.sim.step = MethodType(carry, env.sim)  # type: ignore[method-assign]


def test_a_robot_that_glides_has_the_creep_and_drift_of_its_glide_and_takes_no_steps() -> None:
    cfg = ramp_env_cfg(stage1_env(), STAND)
    cfg.sim.backend = "native"
    env = ManagerBasedRlEnv(cfg)
    glide(env, 0.12, -0.05)
    results = summarise(run_trials(env, lambda _: env.zeros(29), STAND), STAND)
    for result in results:
        standing, along = result.standing, 1.0 / math.cos(math.radians(result.grade))
        assert standing is not None
        assert standing.creep_along == pytest.approx(0.12 * along, rel=1e-3)
        assert standing.creep_across == pytest.approx(0.05, rel=1e-3)
        assert standing.drift == pytest.approx(math.hypot(0.12 * along, 0.05) * 1.0, rel=2e-3)
        assert standing.touchdowns_per_s == 0.0
        assert result.falls.count == result.left_course == 0


def test_the_table_of_standing_robots_has_their_figures() -> None:
    protocol = dataclasses.replace(STAND, seconds=20.0)
    results = summarise(standing(6), protocol)
    assert results[1].standing is not None
    assert results[1].standing.drift == pytest.approx(math.hypot(6.3 / math.cos(math.radians(15.0)), 0.4))
    assert results[1].distance == pytest.approx(7.0 / math.cos(math.radians(15.0)))  # there is no level approach
    console = Console(width=80)
    with console.capture() as captured:
        console.print(table(results))
    rows = [line.split() for line in captured.get().splitlines() if "0/2" in line]
    assert rows[1][5:] == ["0.350", "0.050", "6.31", "2.50", "0.770", "25.0"]
    assert "creep" in captured.get()
    assert "…" not in captured.get()
    assert all(result.standing is None for result in summarise(standing(6), SMALL))


def test_a_foot_touches_the_ground_from_one_newton_on(standing_env: ManagerBasedRlEnv) -> None:
    env = standing_env
    address = env.sim.model.sensor("foot_force_w/left").adr[0]
    data = env.sim.read("sensordata")
    for force, touches in ((0.99, False), (1.01, True)):
        data[:, address : address + 3] = torch.tensor([0.0, 0.0, force])
        env.signals.refresh()
        assert env.signals.foot_contact[:, 0].tolist() == [touches] * env.num_envs


# Walks backward, to a side and across slopes, and turns


def gliding(protocol: RampProtocol, along: float, across: float, turn: float = 0.0) -> list[RampResult]:
    cfg = ramp_env_cfg(stage1_env(), protocol)
    cfg.sim.backend = "native"
    env = ManagerBasedRlEnv(cfg)
    glide(env, along, across, turn)
    return summarise(run_trials(env, lambda _: env.zeros(29), protocol), protocol)


def of_commands(**changes: Any) -> RampProtocol:
    return RampProtocol(**{"grades": (0.0, 20.0, -20.0), "starts": 2, "seconds": 4.0, **changes})


@pytest.mark.parametrize(
    ("command", "velocity"),
    [
        ({"speed": -0.3}, [-0.3, 0.0, 0.0]),
        ({"speed": 0.0, "lateral": 0.3}, [0.0, 0.3, 0.0]),
        ({"speed": 0.0, "yaw_rate": -0.6}, [0.0, 0.0, -0.6]),
        ({"speed": 0.5, "across": True}, [0.5, 0.0, 0.0]),
        ({"speed": 0.5, "lateral": -0.2}, [0.5, -0.2, 0.0]),
    ],
)
def test_the_command_is_what_was_asked_and_the_robot_starts_well_inside_the_plane(
    command: dict[str, Any], velocity: list[float]
) -> None:
    protocol = of_commands(**command)
    cfg = ramp_env_cfg(stage1_env(), protocol)
    cfg.sim.backend = "native"
    env = ManagerBasedRlEnv(cfg)
    start = env.start_qpos.clone()
    start[:, 3:7] = torch.tensor([1.0, 0.0, 0.0, 0.0])
    start[:, 1] += 0.5  # a robot that steered to its centre line would be asked to turn
    env.sim.reset(torch.ones(6, dtype=torch.bool), start, torch.zeros_like(env.start_qvel))
    env.signals.refresh()
    env.commands.step()
    np.testing.assert_allclose(env.commands.velocity, [velocity] * 6, atol=1e-6)
    assert env.commands.moving.all()
    here, grades = env.signals.root_pos_w[:, :2], [g for g in protocol.grades for _ in range(2)]
    rises = torch.tensor([[0.5, 0.0], [0.0, 0.5]])
    uphill, level = rises.flip(0) if protocol.across else rises
    for ahead, expected in ((uphill, grades), (level, [0.0] * 6)):
        slope = torch.rad2deg(torch.atan(env.terrain.height(here + ahead) - env.terrain.height(here - ahead)))
        np.testing.assert_allclose(slope, expected, atol=0.02)
    offset = env.signals.root_pos_w - env.tiles.origin_w
    for axis, speed, middle, extent in ((0, 0, 0.5 * env.tiles.length, env.tiles.length), (1, 1, 0.0, env.tiles.width)):
        assert (offset[:, axis] - middle).abs().max() <= 1.0 + 1e-4
        assert 0.5 * extent >= max(2.5 * abs(velocity[speed]), 0.5) * protocol.seconds + 0.3


def test_a_robot_that_glides_as_commanded_on_the_level_has_no_error() -> None:
    for along, across in ((-0.3, 0.0), (0.0, 0.3)):
        level, *_ = gliding(of_commands(grades=(0.0, 10.0), speed=along, lateral=across), along, across)
        assert level.manoeuvre is not None
        assert level.standing is None
        assert level.speed == pytest.approx(along, abs=1e-3)
        assert level.manoeuvre.lateral_speed == pytest.approx(across, abs=1e-3)
        assert level.manoeuvre.velocity_error == pytest.approx(0.0, abs=2e-3)
        assert level.manoeuvre.yaw_rate_error == pytest.approx(0.0, abs=1e-3)
        assert level.manoeuvre.slip is None


def test_a_robot_that_glides_otherwise_has_the_distance_of_its_velocity_from_the_command() -> None:
    for result in gliding(of_commands(speed=-0.3), 0.1, 0.2):
        along = 0.1 / math.cos(math.radians(result.grade))
        assert result.manoeuvre is not None
        assert result.speed == pytest.approx(along, rel=2e-3)
        assert result.manoeuvre.velocity_error == pytest.approx(math.hypot(along + 0.3, 0.2), rel=2e-3)


def test_a_robot_that_turns_has_its_yaw_rate() -> None:
    for result in gliding(of_commands(speed=0.0, yaw_rate=0.6), 0.0, 0.0, turn=0.45):
        assert result.manoeuvre is not None
        assert result.manoeuvre.yaw_rate == pytest.approx(0.45, rel=1e-3)
        assert result.manoeuvre.yaw_rate_error == pytest.approx(0.15, rel=1e-2)
        assert result.manoeuvre.velocity_error == pytest.approx(0.0, abs=1e-3)


def test_slip_across_a_slope_is_speed_down_it_along_the_ground_on_whichever_side_that_is() -> None:
    level, left_high, right_high = gliding(of_commands(across=True), 0.5, -0.12)
    expected = 0.12 / math.cos(math.radians(20.0))
    assert level.manoeuvre is not None
    assert left_high.manoeuvre is not None
    assert right_high.manoeuvre is not None
    assert level.manoeuvre.slip is None
    assert left_high.manoeuvre.slip == pytest.approx(expected, rel=5e-3)  # to the right, and that is down
    assert right_high.manoeuvre.slip == pytest.approx(-expected, rel=5e-3)
    assert left_high.distance == pytest.approx(0.5 * 4.0, rel=2e-2)  # the way is level


@pytest.mark.parametrize("change", [{"speed": -0.3}, {"across": True}])
def test_the_tables_of_manoeuvres_are_not_cut_off(change: dict[str, Any]) -> None:
    protocol = of_commands(starts=512, seconds=20.0, **change)
    results = summarise(standing(1536, fell=np.ones(1536, dtype=bool), yaw_rate=np.full(1536, -0.1)), protocol)
    console = Console(width=80)
    with console.capture() as captured:
        console.print(table(results))
    assert "512/512" in captured.get()
    assert "…" not in captured.get()
    assert ("slip" in captured.get()) == ("across" in change)


def test_pushes_come_at_their_interval_with_their_speed_in_any_direction() -> None:
    cfg = ramp_env_cfg(stage1_env(), of_commands(push=1.0, push_every=0.5, starts=40))
    cfg.sim.backend = "native"
    env = ManagerBasedRlEnv(cfg)
    env.sim.step = MethodType(lambda sim, n, mask: None, env.sim)  # type: ignore[method-assign]
    qvel, everywhere = env.sim.state("qvel"), torch.ones(env.num_envs, dtype=torch.bool)
    env.sim.reset(everywhere, env.start_qpos, torch.zeros_like(env.start_qvel))
    for _ in range(24):
        env.step(env.zeros(29))
    assert qvel[:, :2].abs().max() == 0.0
    env.step(env.zeros(29))
    kick = qvel[:, :2].clone()
    torch.testing.assert_close(kick.norm(dim=1), torch.ones_like(kick[:, 0]), atol=1e-5, rtol=0)
    assert torch.histc(torch.atan2(kick[:, 1], kick[:, 0]).float(), 4, -math.pi, math.pi).min() > 10
    assert "push" not in dict(ramp_env_cfg(stage1_env(), of_commands()).events.items())


def test_modes_of_a_task_do_not_reach_the_ramps() -> None:
    task = stage1_env()
    task.command.modes = {"turning": 1.0}
    assert ramp_env_cfg(task, SMALL).command.modes == {}
