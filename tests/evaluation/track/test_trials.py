"""The held-out benchmark: who stands, falls or drives, is scored as it did, whoever is measured beside it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from types import MethodType

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.evaluation.track import store
from humoslope.evaluation.track.arrays import to_arrays
from humoslope.evaluation.track.protocol import HeldOutProtocol
from humoslope.evaluation.track.trials import HeldOutTrials, TrialScheduler, held_out_env_cfg, run_trials
from humoslope.managers import ObservationGroupCfg, ObservationTermCfg, Terms
from humoslope.mdp.observations import joint_pos_rel
from humoslope.presets import apply_preset
from humoslope.registry import build_task

FULL = HeldOutProtocol(trials=1)
TINY = HeldOutProtocol(grades=(0.0, 30.0), tiers=(0.6,), trials=3, timeout_s=2.5)


def stage1_env() -> EnvCfg:
    cfg = build_task("HumoSlope-Stage1-Unitree-G1")
    apply_preset(cfg, "cpu")
    cfg.env.sim.backend = "native"
    return cfg.env


def build(
    protocol: HeldOutProtocol,
    parallel: int = 1,
    earlier: HeldOutTrials | None = None,
    change: Callable[[EnvCfg], None] = lambda cfg: None,
) -> tuple[ManagerBasedRlEnv, TrialScheduler]:
    scheduler = TrialScheduler(protocol, protocol.find_course(), parallel, earlier)
    cfg = held_out_env_cfg(stage1_env(), scheduler)
    change(cfg)
    return ManagerBasedRlEnv(cfg), scheduler


def standing(obs: TensorDict) -> Tensor:
    return torch.zeros(len(obs["actor"]), 29)


def stumbling(obs: TensorDict) -> Tensor:
    """Moves by what it sees, noise and all, and falls soon."""
    weights = torch.randn(obs["actor"].shape[1], 29, generator=torch.Generator().manual_seed(0))
    return 0.05 * obs["actor"] @ weights


def assert_same(first: HeldOutTrials, second: HeldOutTrials) -> None:
    for (name, a), b in zip(to_arrays(first).items(), to_arrays(second).values(), strict=True):
        np.testing.assert_array_equal(a, b, err_msg=name)


# What is set up


@pytest.fixture(scope="module")
def full() -> tuple[ManagerBasedRlEnv, TrialScheduler]:
    return build(FULL)


def test_all_cells_stand_side_by_side_with_their_grade_and_friction(
    full: tuple[ManagerBasedRlEnv, TrialScheduler],
) -> None:
    env, _ = full
    cells = [(grade, tier) for grade in FULL.grades for tier in FULL.tiers]
    np.testing.assert_allclose(torch.rad2deg(env.tiles.grade), [grade for grade, _ in cells], atol=1e-4)
    field = env.sim.expand("geom_friction")
    for geom in (name for side in env.robot.foot_geoms for name in side):
        mu = field[:, env.sim.model.geom(geom).id, 0]
        np.testing.assert_allclose(mu, [math.tan(math.radians(g)) + t for g, t in cells], atol=1e-6)


def test_nothing_of_the_task_is_left_but_robot_actions_and_what_the_actor_sees() -> None:
    task = stage1_env()
    cfg = held_out_env_cfg(task, TrialScheduler(FULL, FULL.find_course(), 1))
    assert [dict(terms.items()).keys() for terms in (cfg.terminations, cfg.events, cfg.observations)] == [
        {"trial"},
        {"set_up", "start"},
        {"actor"},
    ]
    assert len(cfg.curriculum) == len(cfg.rewards) == 0
    assert (cfg.sim.timestep, cfg.sim.decimation, cfg.sim.cone) == (0.005, 4, "elliptic")
    assert (task.sim.timestep, task.sim.decimation) == (0.01, 2)
    assert cfg.observations.actor.enable_corruption
    assert cfg.observations.actor.terms is task.observations.actor.terms
    assert cfg.command.speed == (0.5, 0.5)
    assert cfg.command.yaw_rate_limit == 0.2


def test_starts_are_spread_as_stated(full: tuple[ManagerBasedRlEnv, TrialScheduler]) -> None:
    env, scheduler = full
    starts = []
    for seed in range(10):
        scheduler.protocol = dataclasses.replace(FULL, seed=seed)
        scheduler.set_up(env, torch.ones(12, dtype=torch.bool))
        env._restart(torch.ones(12, dtype=torch.bool))
        starts.append(env.sim.state("qpos").clone())
    scheduler.protocol = FULL
    qpos = torch.cat(starts) - torch.cat([env.tiles.origin_w, torch.zeros(12, 33)], dim=1).repeat(10, 1)
    x, y, yaw, joints = qpos[:, 0], qpos[:, 1], 2.0 * qpos[:, 6].asin(), qpos[:, 7:] - env.default_joint_pos
    for values, middle, spread in ((x, 0.5, 0.1), (yaw, 0.0, math.radians(5.0)), (joints, 0.0, 0.05)):
        assert (values - middle).abs().max() <= spread + 1e-5
        assert (values - middle).max() > 0.9 * spread
        assert (values - middle).min() < -0.9 * spread
    assert y.abs().max() < 1e-5
    assert len(x.unique()) == 120
    # Of 120 independent pairs one in ten thousand correlates as much as this.
    drawn = torch.corrcoef(torch.stack([x, yaw, *joints.T[:4]]))
    assert (drawn - torch.eye(6)).abs().max() < 0.4
    lowest = env.robot.default_root_height + env.terrain.height(starts[0][:, :2].float())
    np.testing.assert_allclose(starts[0][:, 2] - lowest, 0.01, atol=1e-5)  # LIFT


def with_map(task: EnvCfg) -> EnvCfg:
    """The task with a second group that a policy might read."""
    joints = ObservationTermCfg(joint_pos_rel, noise=0.01)
    task.observations.actor_map = ObservationGroupCfg(Terms(joints=joints), enable_corruption=True)
    return task


def test_every_group_that_the_policy_reads_is_kept_and_has_noise_of_its_own() -> None:
    def frames(groups: tuple[str, ...]) -> TensorDict:
        scheduler = TrialScheduler(TINY, TINY.find_course(), 1)
        cfg = held_out_env_cfg(with_map(stage1_env()), scheduler, groups)
        assert list(dict(cfg.observations.items())) == list(groups)
        return ManagerBasedRlEnv(cfg).get_observations()

    alone, both, other = frames(("actor",)), frames(("actor", "actor_map")), frames(("actor_map",))
    assert torch.equal(alone["actor"], both["actor"])
    # The same noise would give the same observations whatever the place of the group.
    assert not torch.equal(both["actor_map"], other["actor_map"])
    assert (both["actor_map"] - other["actor_map"]).abs().max() < 0.021
    with pytest.raises(UserError, match="observation group 'actor_mop' does not exist; did you mean 'actor_map'"):
        frames(("actor", "actor_mop"))


# Sanity of the protocol


def test_a_policy_that_stands_scores_nothing_and_ends_near_the_start_at_every_grade() -> None:
    env, scheduler = build(FULL)
    trials = run_trials(env, standing, scheduler)
    assert trials.finished.all()
    assert not trials.success.any()
    assert trials.fell.all()
    assert (trials.max_place < 1.5).all()  # no further than it is tall
    assert list(zip(trials.grade_index, trials.tier_index, strict=True)) == [(g, t) for g in range(4) for t in range(3)]


def slower(cfg: EnvCfg) -> None:
    """Control steps of 0.2 s, for what moves without physics."""
    cfg.sim.timestep, cfg.sim.decimation, cfg.sim.observation_age_s = 0.05, 4, None


def put_on_rails(env: ManagerBasedRlEnv, speed: float, until: float = math.inf) -> None:
    """Replaces the physics: robots are carried along the centre line at `speed`, 0.2 m over the ground, to `until`."""

    def carry(sim: object, n: int, mask: Tensor) -> None:
        qpos = env.sim.state("qpos").clone()
        way = qpos[:, 0] - env.tiles.origin_w[:, 0]
        qpos[:, 0] += speed * n * env.cfg.sim.timestep * (way < until)
        ground = env.terrain.height(qpos[:, :2].float())
        qpos[:, 2] = ground + env.robot.default_root_height + 0.2
        qpos[:, 3:7] = torch.tensor([1.0, 0.0, 0.0, 0.0])
        qvel = torch.zeros_like(env.sim.state("qvel"))
        qvel[:, 0] = speed
        env.sim.reset(mask, qpos, qvel)

    env.sim.step = MethodType(carry, env.sim)  # type: ignore[method-assign]


def test_a_carriage_at_half_a_metre_per_second_always_arrives_and_in_the_right_time() -> None:
    env, scheduler = build(FULL, change=slower)
    start = (env.sim.state("qpos")[:, 0] - env.tiles.origin_w[:, 0]).numpy()
    put_on_rails(env, 0.5)
    trials = run_trials(env, standing, scheduler)
    assert trials.success.all()
    ideal = (31.5 - start) / 0.5
    assert (trials.seconds >= ideal - 1e-3).all()
    assert (trials.seconds <= ideal + env.step_dt + 1e-3).all()
    assert (trials.max_place >= 31.5).all()
    assert (trials.max_place < 31.5 + 0.5 * env.step_dt + 1e-3).all()
    np.testing.assert_allclose(trials.metrics.distance, trials.max_place - start - 0.1, atol=1e-3)


def test_a_carriage_that_stops_on_the_way_is_timed_out_where_it_stands() -> None:
    protocol = dataclasses.replace(FULL, grades=(20.0,), tiers=(0.3,), timeout_s=20.0)
    env, scheduler = build(protocol, change=slower)
    put_on_rails(env, 1.0, until=12.0)
    trials = run_trials(env, standing, scheduler)
    assert trials.timed_out.all()
    assert trials.seconds == pytest.approx(20.0)
    assert trials.max_place == pytest.approx(12.1, abs=0.11)


# The same table, whoever is beside


@pytest.fixture(scope="module")
def whole() -> HeldOutTrials:
    env, scheduler = build(TINY, parallel=2)
    return run_trials(env, stumbling, scheduler)


def test_the_same_command_gives_the_same_figures(whole: HeldOutTrials) -> None:
    env, scheduler = build(TINY, parallel=2)
    assert_same(run_trials(env, stumbling, scheduler), whole)
    assert len(set(whole.seconds)) > 1
    other = dataclasses.replace(TINY, seed=1)
    env, scheduler = build(other, parallel=2)
    assert not np.array_equal(run_trials(env, stumbling, scheduler).max_place, whole.max_place)


def test_an_interrupted_evaluation_goes_on_to_the_same_figures(whole: HeldOutTrials, tmp_path) -> None:
    def interrupt(running: Tensor) -> None:
        if 0 < scheduler.trials().finished.sum() < TINY.num_trials - 1:
            raise KeyboardInterrupt

    env, scheduler = build(TINY, parallel=2)
    with pytest.raises(KeyboardInterrupt):
        run_trials(env, stumbling, scheduler, interrupt)
    store.save(tmp_path / "part.npz", store.SavedTrials(scheduler.trials(), 1.5, ("commit a",)), "mark", TINY)
    kept = store.load(tmp_path / "part.npz", "mark", TINY)
    assert kept is not None
    earlier = kept.trials
    assert 0 < earlier.finished.sum() < TINY.num_trials

    env, scheduler = build(TINY, parallel=2, earlier=earlier)
    stepped: list[Tensor] = []
    resumed = run_trials(env, stumbling, scheduler, stepped.append)
    assert_same(resumed, whole)
    assert sum(int(s.sum()) for s in stepped) < round(whole.seconds.sum() / env.step_dt)


def test_a_first_look_is_the_beginning_of_the_full_evaluation(whole: HeldOutTrials, tmp_path) -> None:
    look = dataclasses.replace(TINY, trials=2)
    env, scheduler = build(look, parallel=2)
    first = run_trials(env, stumbling, scheduler)
    assert_same(first, whole[np.arange(6) % 3 < 2])
    store.save(tmp_path / "look.npz", store.SavedTrials(first, 1.5, ()), "mark", look)
    kept = store.load(tmp_path / "look.npz", "mark", TINY)
    assert kept is not None
    earlier = kept.trials
    assert earlier.finished.tolist() == [True, True, False] * 2
    env, scheduler = build(TINY, parallel=2, earlier=earlier)
    assert_same(run_trials(env, stumbling, scheduler), whole)


def test_every_trial_has_its_own_noise_whatever_the_world_it_is_walked_in() -> None:
    def first_frames(parallel: int) -> Tensor:
        env, scheduler = build(TINY, parallel=parallel)
        seen = torch.zeros(TINY.num_trials, env.get_observations()["actor"].shape[1])
        while scheduler.running.any():
            fresh = scheduler.running & (env.episode_length_buf == 0)
            seen[scheduler.trial[fresh]] = env.get_observations()["actor"][fresh]
            # As good an end of a trial as any.
            env.sim.diverged = lambda: torch.ones(env.num_envs, dtype=torch.bool)  # type: ignore[method-assign]
            env.step(env.zeros(29), scheduler.running)
        return seen

    one, three = first_frames(1), first_frames(3)
    assert torch.equal(one, three)
    assert len(one[:, 0].unique()) == TINY.num_trials


# Worlds that are done


def test_a_world_without_trials_left_is_not_simulated_further() -> None:
    protocol = dataclasses.replace(TINY, trials=1, timeout_s=0.4)
    env, scheduler = build(protocol, parallel=2)  # the second lane of each cell has nothing to do
    assert scheduler.running.tolist() == [True, False, True, False]
    before = env.sim.state("qpos").clone()
    trials = run_trials(env, standing, scheduler)
    assert trials.finished.all()
    assert torch.equal(env.sim.state("qpos")[[1, 3]], before[[1, 3]])
    assert env.sim.state("time")[[1, 3]].abs().max() == 0.0


def test_a_world_that_diverges_has_fallen_and_its_garbage_is_not_measured() -> None:
    protocol = dataclasses.replace(TINY, trials=1, timeout_s=1.0)
    env, scheduler = build(protocol)

    def poison(running: Tensor) -> None:
        if int(env.episode_length_buf[0]) == 10:
            env.sim.state("qvel")[0, 8] = torch.nan

    trials = run_trials(env, standing, scheduler, poison)
    assert trials.fell.tolist()[0]
    assert trials.seconds[0] == pytest.approx(0.22)
    assert trials.metrics.distance[0] < 0.3
    assert np.isfinite(trials.metrics.values["work"][0])
    assert 0.3 < trials.max_place[0] < 0.8


# What is saved


def test_saved_trials_of_anything_else_are_not_used(whole: HeldOutTrials, tmp_path) -> None:
    path = tmp_path / "trials.npz"
    assert store.load(path, "mark", TINY) is None
    store.save(path, store.SavedTrials(whole, 1.5, ("commit a",)), "mark", TINY)
    kept = store.load(path, "mark", TINY)
    assert kept is not None
    assert_same(kept.trials, whole)
    assert store.load(path, "another", TINY) is None
    path.write_bytes(path.read_bytes()[:100])
    assert store.load(path, "mark", TINY) is None


def test_a_later_look_with_fewer_trials_does_not_lose_the_others(whole: HeldOutTrials, tmp_path) -> None:
    path, look = tmp_path / "trials.npz", dataclasses.replace(TINY, trials=1)
    store.save(path, store.SavedTrials(whole, 1.5, ("commit a",)), "mark", TINY)
    first = store.load(path, "mark", look)
    assert first is not None
    assert_same(first.trials, whole[[0, 3]])
    store.save(path, store.SavedTrials(first.trials, 2.5, ("commit a", "commit b")), "mark", look)
    kept = store.load(path, "mark", TINY)
    assert kept is not None
    assert_same(kept.trials, whole)
    assert kept[1:] == (2.5, ("commit a", "commit b"))


def test_the_fingerprint_knows_the_robot_wherever_its_files_lie(tmp_path: Path) -> None:
    def mark(urdf: Path) -> str:
        scheduler = TrialScheduler(TINY, TINY.find_course(), 2)
        cfg = held_out_env_cfg(stage1_env(), scheduler)
        cfg.scene.robot = dataclasses.replace(cfg.scene.robot, urdf=urdf)
        return store.trial_fingerprint(cfg, scheduler, "a")

    here = stage1_env().scene.robot.urdf
    elsewhere, changed = tmp_path / "g1.urdf", tmp_path / "changed.urdf"
    elsewhere.write_bytes(here.read_bytes())
    changed.write_bytes(here.read_bytes() + b"<!-- -->")
    assert mark(here) == mark(elsewhere) != mark(changed)


def test_the_fingerprint_knows_protocol_checkpoint_and_parallel_but_not_how_many_trials() -> None:
    def mark(protocol: HeldOutProtocol = TINY, parallel: int = 2, sha256: str = "a") -> str:
        scheduler = TrialScheduler(protocol, protocol.find_course(), parallel)
        return store.trial_fingerprint(held_out_env_cfg(stage1_env(), scheduler), scheduler, sha256)

    assert mark() == mark()
    assert mark(dataclasses.replace(TINY, trials=5)) == mark()
    changed = [
        mark(dataclasses.replace(TINY, timeout_s=3.0)),
        mark(dataclasses.replace(TINY, grades=(0.0, 20.0))),
        mark(parallel=3),
        mark(sha256="b"),
    ]
    assert len({mark(), *changed}) == 5


def test_the_fingerprint_knows_the_definitions_of_the_metrics_but_not_the_threads(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def mark() -> str:
        scheduler = TrialScheduler(TINY, TINY.find_course(), 2)
        return store.trial_fingerprint(held_out_env_cfg(stage1_env(), scheduler), scheduler, "a")

    first, threads = mark(), torch.get_num_threads()
    torch.set_num_threads(threads + 1)
    try:
        assert mark() == first
    finally:
        torch.set_num_threads(threads)
    monkeypatch.setattr(store, "METRICS_VERSION", store.METRICS_VERSION + 1)
    assert mark() != first
    monkeypatch.undo()
    monkeypatch.setattr(store, "RECORDED", store.RECORDED[1:])
    assert mark() != first


def test_trials_run_on_one_thread_so_that_their_number_does_not_matter() -> None:
    seen = []

    def policy(obs: TensorDict) -> Tensor:
        seen.append(torch.get_num_threads())
        return standing(obs)

    threads = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        env, scheduler = build(dataclasses.replace(TINY, trials=1, timeout_s=0.1))
        run_trials(env, policy, scheduler)
        assert set(seen) == {1}
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(threads)


def test_nothing_is_recorded_outside_of_a_run() -> None:
    env, scheduler = build(dataclasses.replace(TINY, trials=1, timeout_s=0.5))
    env.step(env.zeros(29))
    assert not scheduler.trials().finished.any()
    assert np.isnan(scheduler.trials().metrics.distance).all()
    run_trials(env, standing, scheduler)
    assert len(env.observers) == 0
