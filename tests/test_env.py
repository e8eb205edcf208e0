"""The environment as a whole, on the real Stage I."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from rich.console import Console
from torch import Tensor

from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.managers import (
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    StatefulTerm,
    TerminationTermCfg,
    Terms,
)
from humoslope.registry import build_task
from humoslope.sim import divergence
from humoslope.terrain import TerrainGridCfg

J = 29


def all_of(env: ManagerBasedRlEnv) -> Tensor:
    return torch.ones(env.num_envs, dtype=torch.bool)


def noise(env: ManagerBasedRlEnv, step: int, scale: float = 0.3) -> Tensor:
    """Actions that depend on the step alone, and take nothing from the global generator."""
    return scale * torch.randn(env.num_envs, J, generator=torch.Generator().manual_seed(step))


def few_tiles(cfg: EnvCfg) -> None:
    """A smaller ground, quickly built."""
    cfg.scene.terrain = TerrainGridCfg(columns={"ramp-up": 1.0, "rough-ramp-down": 1.0}, levels=3, num_columns=2)
    cfg.command.modes = {}


def noiseless(cfg: EnvCfg) -> None:
    """On a smaller ground; a reset elsewhere draws numbers that would change what noise the other envs get."""
    few_tiles(cfg)
    cfg.observations.actor.enable_corruption = False


def undisturbed(cfg: EnvCfg) -> None:
    """Nothing random but the place where robots start, no noise, no harness, no curriculum."""
    few_tiles(cfg)
    cfg.events = Terms(root=cfg.events.root, joints=cfg.events.joints)
    cfg.curriculum = Terms()
    cfg.observations.actor.enable_corruption = False


# The physics


def test_an_env_moves_bit_for_bit_as_in_plain_mujoco(make_stage1: Callable[..., ManagerBasedRlEnv]) -> None:
    env = make_stage1(4, undisturbed)
    env.tiles.set_level(torch.tensor([0, 1, 2, 2]))
    env._restart(all_of(env))
    qpos, qvel, ctrl = (env.sim.state(field) for field in ("qpos", "qvel", "ctrl"))
    singles = [mujoco.MjData(env.sim.model) for _ in range(4)]
    for world, data in enumerate(singles):
        data.qpos, data.qvel = qpos[world].numpy(), qvel[world].numpy()
    running, touched = all_of(env), torch.zeros(4, dtype=torch.bool)
    for step in range(40):
        _, _, failed, ended = env.step(noise(env, step))
        running &= ~(failed | ended)
        touched |= env.signals.foot_contact.any(dim=1)
        assert step < 25 or running.any()
        for world, data in enumerate(singles):
            if running[world]:
                # The controls of this step are still there: nothing but a reset changes them.
                data.ctrl = ctrl[world].numpy()
                mujoco.mj_step(env.sim.model, data, env.cfg.sim.decimation)
                np.testing.assert_array_equal(qpos[world].numpy(), data.qpos)
                np.testing.assert_array_equal(qvel[world].numpy(), data.qvel)
    assert touched.all()


def test_the_same_seed_gives_the_same_trajectory_and_another_seed_another(
    make_stage1: Callable[..., ManagerBasedRlEnv],
) -> None:
    def trajectory(seed: int) -> list[Tensor]:
        def change(cfg: EnvCfg) -> None:
            few_tiles(cfg)
            cfg.seed = seed
            cfg.episode_length_s = 0.3
            cfg.events.push.interval_s = (0.1, 0.2)

        env, seen = make_stage1(8, change), []
        seen.append(env.get_observations()["actor"])
        for step in range(20):
            obs, reward, failed, ended = env.step(noise(env, step))
            seen.extend([obs["actor"], obs["critic"], reward, failed, ended])
        return seen

    first, again, other = trajectory(1), trajectory(1), trajectory(2)
    assert all(a.equal(b) for a, b in zip(first, again, strict=True))
    assert not first[0].equal(other[0])
    assert not first[-4].equal(other[-4])


class Press(StatefulTerm):
    """Reset event that pushes the soles 2 cm down, after they were lifted to the ground."""

    def __init__(self, env: ManagerBasedRlEnv) -> None:
        self.env = env

    def __call__(self, env: ManagerBasedRlEnv, mask: Tensor) -> None:
        pass

    def reset(self, mask: Tensor) -> None:
        self.env.start_qpos[:, 2] -= 0.02


def starting(cfg: EnvCfg) -> None:
    """Nothing random but the start, with the soles pressed into the ground, carried by the harness."""
    few_tiles(cfg)
    events = cfg.events
    cfg.events = Terms(root=events.root, joints=events.joints, press=EventTermCfg(Press), harness=events.harness)
    cfg.events.joints.params.update(position=(-0.2, 0.2), velocity=(-1.0, 1.0))
    cfg.episode_length_s = 0.1


def test_an_episode_starts_with_readings_and_wrench_of_its_state_under_the_held_targets(
    make_stage1: Callable[..., ManagerBasedRlEnv],
) -> None:
    env = make_stage1(4, starting)
    model, robot = env.sim.model, env.robot
    root, torso = model.body(robot.root_body).id, model.body(robot.torso_body).id
    qpos, qvel, wrench = (env.sim.state(field) for field in ("qpos", "qvel", "xfrc_applied"))
    for episode in range(2):
        datas = [mujoco.MjData(model) for _ in range(4)]
        touching = 0
        for world, data in enumerate(datas):
            data.qpos, data.qvel, data.ctrl = qpos[world].numpy(), qvel[world].numpy(), robot.default_joint_pos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_comVel(model, data)
            spin = np.zeros(6)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, torso, spin, 0)
            lean = np.cross(data.xmat[torso].reshape(3, 3)[:, 2], [0.0, 0.0, 1.0])
            data.xfrc_applied[root, 2] = 0.5 * robot.total_mass * 9.81
            data.xfrc_applied[torso, 3:5] = (120.0 * lean - 3.0 * spin[:3])[:2]
            np.testing.assert_allclose(wrench[world].numpy(), data.xfrc_applied, atol=1e-3)
            data.xfrc_applied = wrench[world].numpy()
            mujoco.mj_forward(model, data)
            np.testing.assert_allclose(env.signals.joint_torque[world].numpy(), data.actuator_force, atol=1e-3)
            for side in (0, 1):
                force = data.sensor(f"foot_force_w/{('left', 'right')[side]}").data
                np.testing.assert_allclose(env.signals.foot_force_w[world, side].numpy(), force, rtol=1e-4, atol=1e-3)
                touching += np.linalg.norm(force) > 1.0
        assert touching > 0
        env.step(torch.zeros(4, J))
        for world, data in enumerate(datas):  # the whole first control step went by in that wrench
            mujoco.mj_step(model, data, env.cfg.sim.decimation)
            np.testing.assert_allclose(qpos[world].numpy(), data.qpos, atol=1e-6)
        for step in range(4):
            _, _, failed, ended = env.step(noise(env, step))
        assert (failed | ended).all(), episode


# The order of a step


def test_a_step_goes_through_its_parts_in_the_documented_order(
    make_stage1: Callable[..., ManagerBasedRlEnv], monkeypatch: pytest.MonkeyPatch
) -> None:
    env, called = make_stage1(2, few_tiles), []
    env.enable_terminal_observations()
    parts = {
        "process": (env.actions, "process"),
        "physics": (env.sim, "step"),
        "signals": (env.signals, "refresh"),
        "terminations": (env.terminations, "compute"),
        "rewards": (env.rewards, "compute"),
        "events": (env.events, "step"),
        "terminal": (env.observations, "terminal"),
        "curriculum": (env.curriculum, "step"),
        "curriculum ends": (env.curriculum, "reset"),
        "reset": (env.sim, "reset"),
        "commands": (env.commands, "step"),
        "observations": (env.observations, "compute"),
    }

    def noting(name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any) -> Any:
            called.append(name)
            return method(*args)

        return call

    for name, (owner, method) in parts.items():
        monkeypatch.setattr(owner, method, noting(name, getattr(owner, method)))
    env.observers.append(lambda env: called.append("observers"))
    physics = ["physics"] * env.cfg.sim.decimation  # one by one, to keep the readings on the way
    before = ["process", *physics, "signals", "terminations", "rewards", "observers", "events"]
    env.step(noise(env, 0))
    assert called == [*before, "curriculum", "commands", "observations"]
    called.clear()
    env.episode_length_buf[0] = env.max_episode_length - 1
    env.step(noise(env, 1))
    ends = ["terminal", "curriculum", "curriculum ends", "reset", "signals"]
    assert called == [*before, *ends, "commands", "observations"]


def test_observers_see_the_end_of_an_episode_before_it_is_reset(
    make_stage1: Callable[..., ManagerBasedRlEnv],
) -> None:
    env, seen = make_stage1(2, few_tiles), []

    def observe(env: ManagerBasedRlEnv) -> None:
        seen.append((env.episode_length_buf.tolist(), env.terminations.time_outs.tolist(), env.rewards.last.clone()))

    env.observers.append(observe)
    env.episode_length_buf[1] = env.max_episode_length - 1
    env.step(noise(env, 0))
    env.step(noise(env, 1))
    assert [lengths for lengths, _, _ in seen] == [[1, env.max_episode_length], [2, 1]]
    assert [time_outs for _, time_outs, _ in seen] == [[False, True], [False, False]]
    assert (seen[0][2] != 0.0).any(dim=1).all()


# Terminal observations


def short(cfg: EnvCfg) -> None:
    """Undisturbed episodes of 0.24 s under a command that holds, observed as vectors and as a map."""
    undisturbed(cfg)
    scan = ObservationTermCfg(
        lambda env: env.height_scan.heights_w.view(-1, 1, 7, 7) - env.signals.root_pos_w[:, 2:, None, None]
    )
    cfg.observations.map = ObservationGroupCfg(Terms(scan=scan), history=2)
    cfg.episode_length_s = 0.24
    cfg.command.heading_share = 0.0


def endless(cfg: EnvCfg) -> None:
    """The same, and no episode ever ends."""
    short(cfg)
    cfg.terminations = Terms()


def test_the_terminal_observation_is_the_one_that_would_have_followed_without_a_reset(
    make_stage1: Callable[..., ManagerBasedRlEnv],
) -> None:
    env, twin = make_stage1(6, short), make_stage1(6, endless)
    env.enable_terminal_observations()
    env.episode_length_buf = torch.tensor([0, 3, 3, 7, 7, 11])
    first, ends = torch.ones(6, dtype=torch.bool), 0
    for step in range(14):
        action = noise(env, step)
        obs, _, failed, ended = env.step(action)
        uninterrupted, _, _, _ = twin.step(action)
        done = failed | ended
        for group in ("actor", "critic", "map"):
            terminal = env.terminal_observations[group]
            assert terminal[~done].equal(obs[group][~done])
            assert terminal[done & first].equal(uninterrupted[group][done & first])
            assert not terminal[done].isclose(obs[group][done]).flatten(1).all(dim=1).any()
        assert obs["map"].shape == (6, 2, 7, 7)
        ends += int((done & first).sum())
        first &= ~done
    assert ends == 6


def test_who_asks_for_terminal_observations_gets_the_same_rollout(
    make_stage1: Callable[..., ManagerBasedRlEnv], monkeypatch: pytest.MonkeyPatch
) -> None:
    def change(cfg: EnvCfg) -> None:
        noiseless(cfg)
        cfg.episode_length_s = 0.1

    env, twin = make_stage1(4, change), make_stage1(4, change)
    env.enable_terminal_observations()
    monkeypatch.setattr(twin.observations, "terminal", None)  # whoever does not ask never computes one
    for step in range(12):
        results = []
        for one in (env, twin):
            torch.manual_seed(step)
            results.append(one.step(noise(one, step)))
        for ours, theirs in zip(*results, strict=True):
            assert bool((ours == theirs).all())
    assert not hasattr(twin, "terminal_observations")


def test_the_terminal_observation_keeps_the_noise_of_the_frames_before_it(
    make_stage1: Callable[..., ManagerBasedRlEnv],
) -> None:
    env = make_stage1(4, few_tiles)
    env.enable_terminal_observations()
    for step in range(6):
        before = env.step(noise(env, step))[0]["actor"]
    env.episode_length_buf[2] = env.max_episode_length - 1
    env.step(noise(env, 6))
    start = 0
    for (width,) in env.observations.groups["actor"].term_shapes.values():
        frames = slice(start, start + 4 * width), slice(start + width, start + 5 * width)
        assert env.terminal_observations["actor"][2, frames[0]].equal(before[2, frames[1]])
        start += 5 * width


def test_a_diverged_env_has_no_terminal_observation_but_finite_values(
    make_stage1: Callable[..., ManagerBasedRlEnv],
) -> None:
    env = make_stage1(4, noiseless)
    env.enable_terminal_observations()
    env.step(noise(env, 0))
    env.sim.state("qvel")[1, 8] = torch.nan
    obs, _, failed, _ = env.step(noise(env, 1))
    assert failed.tolist() == [False, True, False, False]
    assert all(env.terminal_observations[group].equal(obs[group]) for group in ("actor", "critic"))


def test_terminal_observations_go_on_after_a_state_was_loaded(make_stage1: Callable[..., ManagerBasedRlEnv]) -> None:
    env = make_stage1(2, noiseless)
    env.enable_terminal_observations()
    env.step(noise(env, 0))
    env.load_state_dict(env.state_dict())
    assert env.terminal_observations["actor"].equal(env.get_observations()["actor"])


# What is seen


def test_observations_are_fresh_tensors_that_no_later_step_writes(
    make_stage1: Callable[..., ManagerBasedRlEnv],
) -> None:
    env = make_stage1(8, few_tiles)
    kept, copies = [env.get_observations()], [env.get_observations().clone()]
    for step in range(4):
        action = noise(env, step)
        obs, reward, failed, ended = env.step(action)
        kept.append(obs)
        copies.append(obs.clone())
        assert env.get_observations() is obs
        action.fill_(100.0)
        assert reward.shape == failed.shape == ended.shape == (8,)
    for obs, copy in zip(kept, copies, strict=True):
        assert all(obs[group].equal(copy[group]) for group in ("actor", "critic"))
    for group in ("actor", "critic"):
        assert len({obs[group].data_ptr() for obs in kept}) == len(kept)


PROPRIOCEPTIVE = ("joint_pos/", "joint_vel/", "root_quat_w", "root_ang_vel_b")
"""Sensors that the robot has; of the orientation the actor gets the direction of gravity alone."""


def test_a_step_takes_one_thread_of_torch_and_gives_the_others_back_even_if_it_fails(
    make_stage1: Callable[..., ManagerBasedRlEnv], monkeypatch: pytest.MonkeyPatch
) -> None:
    env, before = make_stage1(2), torch.get_num_threads()
    seen = []
    monkeypatch.setattr(env.sim, "step", lambda n, mask: seen.append(torch.get_num_threads()))
    try:
        torch.set_num_threads(2)
        env.step(noise(env, 0))
        assert torch.get_num_threads() == 2
        with pytest.raises(RuntimeError):
            env.step(torch.zeros(5, 1))
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
    assert set(seen) == {1}


def test_what_is_computed_on_demand_belongs_to_the_last_refresh(make_stage1: Callable[..., ManagerBasedRlEnv]) -> None:
    env = make_stage1(4, noiseless)
    before = env.signals.root_lin_vel_t
    for step in range(5):
        env.step(noise(env, step))
    late = env.signals.root_lin_vel_t
    assert not late.equal(before)
    env.signals.refresh()
    assert env.signals.root_lin_vel_t.equal(late)


def test_nothing_that_only_a_simulator_knows_reaches_the_actor(make_stage1: Callable[..., ManagerBasedRlEnv]) -> None:
    env = make_stage1(12)
    for step in range(5):
        env.step(noise(env, step))

    def observe() -> dict[str, Tensor]:
        torch.manual_seed(0)  # the same noise on the actor's observations
        env.signals.refresh()
        return dict(env.observations.compute(all_of(env)).items())

    model, generator = env.sim.model, torch.Generator().manual_seed(0)
    for side in ("left", "right"):  # half of the robots are in the air, so that contact can change
        sensor = model.sensor(f"foot_force_w/{side}")
        env.signals._sensordata[:6, sensor.adr[0] : sensor.adr[0] + sensor.dim[0]] = 0.0
    before = observe()

    def scramble(x: Tensor, scale: float) -> None:
        x += scale * torch.randn(x.shape, generator=generator)

    for i in range(model.nsensor):
        sensor = model.sensor(i)
        if not sensor.name.startswith(PROPRIOCEPTIVE):
            columns = slice(sensor.adr[0], sensor.adr[0] + sensor.dim[0])
            scramble(env.signals._sensordata[:, columns], 300.0 if "force" in sensor.name else 1.0)
    scramble(env.signals._actuator_force, 10.0)
    scramble(env.terrain._planes, 0.2)
    scramble(env.sim.expand("geom_friction"), 0.1)
    scramble(env.sim.expand("body_mass"), 0.1)
    scramble(env.sim.state("xfrc_applied"), 10.0)
    env.tiles.set_level(env.tiles.level + 1)
    after = observe()

    assert after["actor"].equal(before["actor"])
    start = 0
    critic = env.observations.groups["critic"]
    for name, (width,) in critic.term_shapes.items():
        changed = not after["critic"][:, start : start + width].equal(before["critic"][:, start : start + width])
        assert changed == (name not in env.observations.groups["actor"].term_shapes), name
        start += width


def test_the_actor_sees_five_steps_of_what_the_robot_measures_and_does(
    make_stage1: Callable[..., ManagerBasedRlEnv],
) -> None:
    env = make_stage1(2, few_tiles)
    assert env.observations.groups["actor"].term_shapes == {
        "base_ang_vel": (3,),
        "projected_gravity": (3,),
        "velocity_command": (3,),
        "joint_pos_rel": (J,),
        "joint_vel": (J,),
        "last_action": (J,),
    }
    assert env.get_observations()["actor"].shape == (2, 5 * 96)
    assert env.get_observations()["critic"].shape == (2, 96 + 3 + 2 + 2 + 2 + 1 + 49)


# Envs that go wrong

BROKEN = {
    "nan_velocity": ("qvel", torch.nan),
    "huge_velocity": ("qvel", 1e15),
    "endless_velocity": ("qvel", torch.inf),
    "nan_position": ("qpos", torch.nan),
    "huge_position": ("qpos", 1e15),
}


@pytest.mark.parametrize("accident", BROKEN)
def test_an_env_that_diverges_is_reset_counted_and_kept_for_a_look_and_the_others_go_on(
    make_stage1: Callable[..., ManagerBasedRlEnv], accident: str
) -> None:
    env, twin = make_stage1(8, noiseless), make_stage1(8, noiseless)
    for one in (env, twin):
        torch.manual_seed(5)
        walked = []
        for step in range(divergence.STEPS):
            one.step(noise(one, step))
            walked.append(one.sim.state("qpos")[3].clone())
        one.log.flush()
    field, value = BROKEN[accident]
    env.sim.state(field)[3, 8] = value

    others = [0, 1, 2, 4, 5, 6, 7]
    for step in range(3):
        results = []
        for one in (env, twin):
            torch.manual_seed(step)
            results.append(one.step(noise(one, 100 + step)))
        (obs, reward, failed, ended), (obs_twin, reward_twin, failed_twin, _) = results
        for tensor in (obs["actor"], obs["critic"], reward, env.sim.state("qpos"), env.sim.state("qvel")):
            assert tensor.isfinite().all()
        assert failed[3].item() is (step == 0)
        assert not ended[3]
        assert reward[3] == 0.0 or step > 0
        # The others do not even notice.
        assert failed[others].equal(failed_twin[others])
        assert reward[others].equal(reward_twin[others])
        assert obs["critic"][others].equal(obs_twin["critic"][others])
        assert obs["actor"][others].equal(obs_twin["actor"][others])
    assert env.episode_length_buf[3] == 2
    assert env.tiles.level.equal(twin.tiles.level)

    logged = env.log.flush()
    assert all(np.isfinite(list(logged.values())))
    assert logged["Train/diverged"] == pytest.approx(1 / 8 / 3)
    assert twin.take_divergence() is None
    states = env.take_divergence()
    assert states is not None
    qpos, qvel = states
    assert qpos.shape == (divergence.STEPS, 36)
    assert qvel.shape == (divergence.STEPS, 35)
    assert qpos[:-1].isfinite().all()  # how it came to it
    assert (qpos[:-1, 7:].diff(dim=0).abs().amax(dim=1) > 0.0).all()  # step by step, oldest first
    # Of the world that diverged.
    torch.testing.assert_close(qpos[:-1], torch.stack(walked)[1:], check_dtype=False)
    assert qpos[:-1, 7:].diff(dim=0).abs().max() < 0.5
    assert env.take_divergence() is None


def test_values_that_are_not_finite_are_reported_by_name_and_the_look_starts_anew(
    make_stage1: Callable[..., ManagerBasedRlEnv],
) -> None:
    poison = torch.zeros(4)

    def change(cfg: EnvCfg) -> None:
        few_tiles(cfg)
        cfg.rewards.ratio = RewardTermCfg(lambda env: poison / poison, weight=0.1)
        cfg.observations.critic.terms.load = ObservationTermCfg(lambda env: (poison / poison)[:, None])

    poison += 1.0
    env = make_stage1(4, change)
    for step in range(3):
        env.step(noise(env, step))
    assert env.non_finite() == []
    env.step(noise(env, 3))
    poison[1:3] = 0.0
    env.step(noise(env, 4))
    action = noise(env, 5)
    action[0, 3] = torch.inf
    env.step(action)
    poison += 1.0
    env.step(noise(env, 6))
    assert sorted(env.non_finite()) == [
        "observation 'critic.load' was not finite in 2 of 4 envs (first in step 2 since the last look)",
        "reward 'ratio' was not finite in 2 of 4 envs (first in step 2 since the last look)",
        "the action was not finite in 1 of 4 envs (first in step 3 since the last look)",
    ]
    env.step(noise(env, 7))
    assert env.non_finite() == []


def test_a_term_that_is_not_finite_in_a_diverged_env_alone_is_no_fault(
    make_stage1: Callable[..., ManagerBasedRlEnv],
) -> None:
    def upright(env: ManagerBasedRlEnv) -> Tensor:  # 0/0 for the zeros that a diverged env reads
        quat = env.signals.root_quat_w
        return quat[:, 0] / quat.norm(dim=1)

    def change(cfg: EnvCfg) -> None:
        few_tiles(cfg)
        cfg.rewards.upright = RewardTermCfg(upright)
        cfg.observations.critic.terms.upright = ObservationTermCfg(lambda env: upright(env)[:, None])

    env = make_stage1(4, change)
    env.sim.state("qvel")[1, 8] = torch.nan
    _, reward, failed, _ = env.step(noise(env, 0))
    assert failed.tolist() == [False, True, False, False]
    assert reward.isfinite().all()
    env.step(noise(env, 1))
    assert env.non_finite() == []
    assert all(np.isfinite(list(env.log.flush().values())))


def test_a_look_may_be_taken_in_inference_mode_and_outside(make_stage1: Callable[..., ManagerBasedRlEnv]) -> None:
    def change(cfg: EnvCfg) -> None:
        few_tiles(cfg)
        cfg.episode_length_s = 0.04  # two steps, so that episodes end in it

    env = make_stage1(2, change)
    with torch.inference_mode():
        env.step(noise(env, 0))
        assert env.non_finite() == []
        env.step(noise(env, 1))
    assert env.non_finite() == []
    env.step(noise(env, 2))


# Episodes


def test_the_logged_length_is_what_episodes_lived_though_a_learner_lets_the_first_ones_begin_late(
    make_stage1: Callable[..., ManagerBasedRlEnv],
) -> None:
    def change(cfg: EnvCfg) -> None:
        undisturbed(cfg)
        cfg.episode_length_s = 0.2

    env = make_stage1(4, change)
    env.episode_length_buf = torch.tensor([0, 8, 6, 6])
    for step in range(9):
        env.step(noise(env, step))
    logged = env.log.flush()
    assert logged["Train/episode_length"] == pytest.approx((2 + 4 + 4) / 3)
    assert not any(name.startswith("Termination/") for name in logged)  # cut short by the learner alone
    env.step(noise(env, 9))  # env 0 has lived all its time
    logged = env.log.flush()
    assert logged["Train/episode_length"] == 10.0
    assert logged["Termination/time_out"] == 1.0
    assert logged["Termination/tilted"] == 0.0


class Calls(StatefulTerm):
    """Number of calls since the reset."""

    def __init__(self, env: ManagerBasedRlEnv) -> None:
        self.calls = env.zeros()

    def __call__(self, env: ManagerBasedRlEnv) -> Tensor:
        self.calls = self.calls + 1.0
        return self.calls

    def reset(self, mask: Tensor) -> None:
        self.calls = self.calls.masked_fill(mask, 0.0)


class CallColumn(Calls):
    """The same as an observation."""

    def __call__(self, env: ManagerBasedRlEnv) -> Tensor:
        return super().__call__(env)[:, None]


class FourthCall(Calls):
    """A termination after four steps."""

    def __call__(self, env: ManagerBasedRlEnv) -> Tensor:
        return super().__call__(env) >= 4.0


@pytest.mark.parametrize("terminal", [False, True])
def test_an_episode_takes_the_memory_of_every_term_with_it(
    make_stage1: Callable[..., ManagerBasedRlEnv], terminal: bool
) -> None:
    def change(cfg: EnvCfg) -> None:
        undisturbed(cfg)
        cfg.rewards = Terms(calls=RewardTermCfg(Calls))
        cfg.observations = Terms(actor=ObservationGroupCfg(Terms(calls=ObservationTermCfg(CallColumn))))
        cfg.terminations = Terms(fourth=TerminationTermCfg(FourthCall))

    env = make_stage1(2, change)
    if terminal:
        env.enable_terminal_observations()
    seen = []
    for step in range(9):
        obs, _, failed, _ = env.step(noise(env, step))
        seen.append((obs["actor"][0, 0].item(), env.rewards.last[0, 0].item(), failed[0].item()))
    observed, rewarded, failed_in = zip(*seen, strict=True)
    assert rewarded == (1.0, 2.0, 3.0, 4.0, 1.0, 2.0, 3.0, 4.0, 1.0)
    assert failed_in == (False, False, False, True) * 2 + (False,)
    assert observed == (2.0, 3.0, 4.0, 1.0, 2.0, 3.0, 4.0, 1.0, 2.0)  # the first of an episode belongs to its start
    assert env.log.flush()["Termination/fourth"] == 1.0


def test_a_policy_that_gives_nan_harms_nothing(make_stage1: Callable[..., ManagerBasedRlEnv]) -> None:
    env = make_stage1(2, few_tiles)
    obs, reward, _, _ = env.step(torch.full((2, J), torch.nan))
    assert reward.isfinite().all()
    assert obs["actor"].isfinite().all()
    assert env.sim.state("qpos").isfinite().all()


# Checkpoints


def test_harness_and_levels_come_back_from_a_state_and_all_envs_start_on_their_tiles(
    make_stage1: Callable[..., ManagerBasedRlEnv],
) -> None:
    env = make_stage1(8, few_tiles)
    level = torch.tensor([0, 1, 2, 1, 2, 0, 2, 1])
    env.tiles.set_level(level)
    harness = {"scale": 0.0, "strictness": 0.4, "falls": 0.01, "speed": 0.8}
    env.curriculum.load_state_dict({"harness": harness})
    file = io.BytesIO()
    torch.save(env.state_dict(), file)
    file.seek(0)
    state = torch.load(file, weights_only=True)

    for num_envs, expected in ((8, level), (4, level[::2]), (16, level.repeat_interleave(2))):
        other = make_stage1(num_envs, few_tiles)
        for step in range(3):
            other.step(noise(other, step))
        other.load_state_dict(state)
        assert other.tiles.level.equal(expected)
        assert other.events["harness"].scale == 0.0
        assert other.curriculum.state_dict()["harness"] == pytest.approx(harness)
        assert other.episode_length_buf.count_nonzero() == 0
        place = other.sim.state("qpos")[:, 0] - other.tiles.origin_w[:, 0]
        assert ((place - other.tiles.spawn_x).abs() < 0.16).all()
        assert other.get_observations()["actor"].isfinite().all()
        other.step(noise(other, 9))
        assert other.tiles.level.equal(expected)  # no world moves before its episode has ended


def test_the_first_commands_of_a_run_are_as_varied_as_its_curriculum_says(
    make_stage1: Callable[..., ManagerBasedRlEnv],
) -> None:
    def stand(cfg: EnvCfg) -> None:
        cfg.command.standing_share = 1.0

    env = make_stage1(8, stand)
    assert not env.commands.variety.any()
    assert env.commands.moving.all()
    state = env.state_dict()
    state["curriculum"]["skills"]["variety"] = [0.0, 0.0, 0.0, 1.0]
    env.load_state_dict(state)
    assert not env.commands.moving.any()


def test_a_reset_begins_episodes_where_it_is_asked_to_and_leaves_the_others_alone(
    make_stage1: Callable[..., ManagerBasedRlEnv],
) -> None:
    env = make_stage1(4, few_tiles)
    env.enable_terminal_observations()
    for step in range(5):
        env.step(noise(env, step))
    before, qpos = env.get_observations(), env.sim.state("qpos").clone()
    chosen = torch.tensor([True, False, False, True])
    obs = env.reset(chosen)
    assert obs is env.get_observations()
    assert obs is env.terminal_observations
    assert env.steps_since_reset.tolist() == [0, 5, 5, 0]
    assert env.episode_length_buf.tolist() == [0, 5, 5, 0]
    moved = (env.sim.state("qpos") != qpos).any(dim=1)
    assert moved.equal(chosen)
    frames = obs["actor"].view(4, -1)
    assert (frames != before["actor"]).any(dim=1)[chosen].all()
    env.reset()
    assert env.steps_since_reset.tolist() == [0] * 4


def test_levels_that_are_no_more_there_are_cut(make_stage1: Callable[..., ManagerBasedRlEnv]) -> None:
    env = make_stage1(4, few_tiles)
    env.load_state_dict(env.state_dict() | {"level": torch.tensor([0, 2, 7, 9])})
    assert env.tiles.level.tolist() == [0, 2, 2, 2]


# The tasks


@pytest.mark.parametrize(
    ("task", "zmp"),
    [
        ("HumoSlope-Stage1-Unitree-G1", {}),
        ("HumoSlope-Stage1-NoZMP-Unitree-G1", None),
        ("HumoSlope-Stage1-HorizontalZMP-Unitree-G1", {"plane": "horizontal"}),
    ],
)
def test_the_ablations_of_stage_one_differ_in_the_zmp_alone(task: str, zmp: dict[str, str] | None) -> None:
    cfg, full = build_task(task).env, build_task("HumoSlope-Stage1-Unitree-G1").env
    assert (cfg.rewards.zmp.params if "zmp" in cfg.rewards else None) == zmp
    for part in ("rewards", "events", "terminations", "curriculum"):
        terms, others = (dict(getattr(config, part).items()) for config in (cfg, full))
        terms.pop("zmp", None), others.pop("zmp", None)
        assert terms == others
    for group, other in zip(cfg.observations.items(), full.observations.items(), strict=True):
        assert dict(group[1].terms.items()) == dict(other[1].terms.items())
        assert (group[0], group[1].history, group[1].enable_corruption) == (
            other[0],
            other[1].history,
            other[1].enable_corruption,
        )
    cfg.num_envs = 2
    cfg.sim.backend = "native"
    few_tiles(cfg)
    env = ManagerBasedRlEnv(cfg)
    _, reward, _, _ = env.step(noise(env, 0))
    assert reward.isfinite().all()


def test_a_description_names_every_term(make_stage1: Callable[..., ManagerBasedRlEnv]) -> None:
    env, out = make_stage1(2, few_tiles), io.StringIO()
    env.describe(Console(file=out, width=200))
    cfg = env.cfg
    for terms in (cfg.rewards, cfg.terminations, cfg.events, cfg.curriculum, cfg.observations.actor.terms):
        for name, _ in terms.items():
            assert name in out.getvalue()
    assert "left_knee_joint" in out.getvalue()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda cfg: setattr(cfg, "num_envs", 0), "env.num_envs is 0; it must be between 1 and 1,000,000"),
        (
            lambda cfg: setattr(cfg, "episode_length_s", 0.0),
            "env.episode_length_s is 0; it must be between 0 and 100,000, 0 excluded",
        ),
        (lambda cfg: setattr(cfg, "episode_length_s", 0.005), "episode_length_s is 0.005 s; .* control step of 0.02 s"),
        (lambda cfg: setattr(cfg, "episode_length_s", float("nan")), "episode_length_s is nan; it must be"),
        (
            lambda cfg: setattr(cfg.sim, "timestep", float("inf")),
            "timestep is inf; it must be between 0.0001 and 0.05",
        ),
        (lambda cfg: setattr(cfg.sim, "decimation", 0), "env.sim.decimation is 0; it must be between 1 and 1,000"),
        (lambda cfg: cfg.rewards.pitch.params.update(share=1.0), "reward 'pitch': parameter 'share' does not exist"),
    ],
)
def test_an_environment_that_cannot_be_is_refused_in_a_sentence(
    make_stage1: Callable[..., ManagerBasedRlEnv], change: Callable[[EnvCfg], None], message: str
) -> None:
    with pytest.raises(UserError, match=message):
        make_stage1(2, lambda cfg: (few_tiles(cfg), change(cfg)))
