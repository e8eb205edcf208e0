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
    along_course,
    ramp_env_cfg,
    run_trials,
    summarise,
    table,
)
from humoslope.presets import apply_preset
from humoslope.provenance import plain
from humoslope.registry import build_task

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
        "squared_error": np.full(count, 900.0 * 0.15**2),
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
        ({"grades": ()}, "there are no grades"),
        ({"grades": (0.0, 90.0)}, "grade 90 must be between -60 and 60 degrees"),
        ({"grades": (float("nan"),)}, "grade nan"),
        ({"starts": 0}, "starts is 0"),
        ({"speed": -0.1}, "speed is -0.1; it must be 0 or more"),
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


def glide(env: ManagerBasedRlEnv, along: float, across: float) -> None:
    """Replaces the physics: robots glide over the ground at these horizontal speeds, without turning."""

    def carry(sim: object, n: int, mask: torch.Tensor | None) -> None:
        qpos = env.sim.state("qpos").clone()
        qpos[:, 0] += along * env.step_dt
        qpos[:, 1] += across * env.step_dt
        qpos[:, 2] = env.terrain.height(qpos[:, :2].float()) + env.robot.default_root_height + 0.2
        qpos[:, 3:7] = torch.tensor([1.0, 0.0, 0.0, 0.0])
        qvel = torch.zeros_like(env.sim.state("qvel"))
        qvel[:, 0], qvel[:, 1] = along, across
        qvel[:, 2] = along * torch.tan(torch.deg2rad(torch.tensor(GRADES_OF_STAND)))
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
