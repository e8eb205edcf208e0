"""Gallant's task has the published list of rewards and terminations, and the other baselines' world."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict

from humoslope.check.host_sync import no_host_sync
from humoslope.env import ManagerBasedRlEnv
from humoslope.errors import UserError
from humoslope.evaluation.track.protocol import HeldOutProtocol
from humoslope.evaluation.track.trials import TrialScheduler, held_out_env_cfg
from humoslope.learning.gallant.config import GallantCfg
from humoslope.learning.symmetry import Mirror
from humoslope.managers import ObservationGroup
from humoslope.managers.goal import GoalCommand
from humoslope.presets import apply_preset
from humoslope.provenance import plain
from humoslope.registry import TaskCfg, build_task
from humoslope.terrain import TerrainGridCfg
from robots.unitree_g1 import UNITREE_G1
from tasks.gallant import DEVIATIONS

GALLANT, URL = "Gallant-Unitree-G1", "URL-TerrainRelative-Unitree-G1"

PUBLISHED = {
    **{"velocity_direction": 2.0, "reach_goal": 2.0, "at_goal": 1.0, "stance": 2.0, "head_height": 1.5},
    **{"pace": -1.0, "torso_lean": -0.5, "pelvis_lean": -1.0, "body_force": -1.0, "sole_points": 1.5},
    **{"slip": -1.0, "low_swing": -1.5, "pitched_feet": -0.1, "lin_vel_z": -0.5, "ang_vel_xy": -0.05},
    **{"action_rate": -1e-2, "action_acc": -5e-3, "joint_acc": -2.5e-7, "joint_limits": -1.0},
    **{"feet_apart": -1.5, "legs_apart": -1.5, "feet_parallel": -1.0, "stumble": -1.0, "torques": -2.5e-6},
    **{"joint_vel": -1e-4, "fast_joints": -2e-3, "strong_joints": -0.01, "heavy_feet": -1e-6, "landing": -2.5e-4},
    "heading": -2 * 1.5,  # the original adds the pelvis's heading to the root's, which is the same one
    "power": -2e-10 * 1e6,  # of W^2, here of kW^2
    **{"hip_yaw_deviation": -0.5, "hip_roll_deviation": -1.0, "hip_pitch_deviation": -0.05, "knee_deviation": -0.02},
    **{"ankle_pitch_deviation": -0.1, "ankle_roll_deviation": -1.5, "waist_roll_yaw_deviation": -1.0},
    **{"waist_pitch_deviation": -0.5, "arm_roll_yaw_deviation": -1.0, "arm_deviation": -0.5, "wrist_deviation": -1.0},
}
"""Gallant, cfg/task/G1LidarNew.yaml; of its 44 terms three contact penalties are one."""


@pytest.fixture(scope="module")
def env() -> ManagerBasedRlEnv:
    cfg = build_task(GALLANT)
    apply_preset(cfg, "cpu")
    cfg.env.num_envs, cfg.env.sim.backend = 8, "native"
    cfg.env.scene.terrain = TerrainGridCfg(columns={"ramp-up": 0.5, "hillside": 0.5}, levels=2, num_columns=2)
    return ManagerBasedRlEnv(cfg.env)


def test_the_weights_are_the_published_ones() -> None:
    terms = build_task(GALLANT).env.rewards
    assert {name: term.weight for name, term in terms.items()} == pytest.approx(PUBLISHED)
    assert len(PUBLISHED) == 44 - 2
    assert terms.head_height.params["target"] == 1.32
    assert terms.pace.params["pace"] == (0.4, 0.8)


def test_every_joint_but_none_twice_has_a_price_on_its_deviation() -> None:
    hits = [n for n in UNITREE_G1.joint_names for joints, _ in DEVIATIONS.values() if re.fullmatch(joints, n)]
    assert sorted(hits) == sorted(UNITREE_G1.joint_names)


def test_world_friction_randomisation_and_harness_are_those_of_the_other_baselines() -> None:
    own, theirs = plain(build_task(GALLANT).env), plain(build_task(URL).env)
    assert {name for name in own if own[name] != theirs[name]} == {
        *("command", "observations", "rewards", "terminations", "curriculum")
    }
    # Goals are always to be walked to.
    assert set(theirs["curriculum"]) - set(own["curriculum"]) == {"skills"}
    for same in ("harness", "terrain_levels"):
        assert own["curriculum"][same] == theirs["curriculum"][same]
    for same in ("time_out", "off_tile"):
        assert own["terminations"][same] == theirs["terminations"][same]


def test_a_lean_whose_sine_is_0_8_is_a_fall_as_published() -> None:
    assert build_task(GALLANT).env.terminations.tilted.params["degrees"] == pytest.approx(53.13, abs=0.01)


def test_the_full_grid_is_that_of_gpus_and_a_reduced_one_that_of_cpus() -> None:
    def scaled(preset: str) -> TaskCfg:
        cfg = build_task(GALLANT)
        apply_preset(cfg, preset)
        return cfg

    gpu, cpu = scaled("gpu"), scaled("cpu")
    assert gpu.env.observations.voxels.terms.columns.params == {"cell": 0.05}
    assert cpu.env.observations.voxels.terms.columns.params == {"cell": 0.1}
    assert plain(gpu.env.rewards) == plain(cpu.env.rewards)
    for agent in (gpu.agent, cpu.agent):
        assert isinstance(agent, GallantCfg)
        assert (agent.hidden_dims, agent.proprioception_dim, agent.voxel_dim) == ((256,), 256, 64)
    assert (gpu.agent.num_steps_per_env, gpu.agent.num_learning_epochs) == (48, 4)
    assert (cpu.agent.num_steps_per_env, cpu.agent.num_learning_epochs) == (24, 2)


def test_rsl_rl_is_told_the_published_ppo() -> None:
    told = build_task(GALLANT).agent.to_rsl_rl()
    groups = ["command", "proprioception", "last_actions", "voxels"]
    assert told["obs_groups"] == {"actor": groups, "critic": groups}
    expected = {
        **{"num_learning_epochs": 4, "num_mini_batches": 4, "learning_rate": 5e-4, "desired_kl": 0.02, "gamma": 0.99},
        **{"lam": 0.95, "clip_param": 0.2, "entropy_coef": 0.003, "value_loss_coef": 1.0, "max_grad_norm": 1.0},
        **{"optimizer": "adamw", "use_clipped_value_loss": False, "max_learning_rate": 5e-4},
    }
    assert {name: told["algorithm"][name] for name in expected} == expected
    assert build_task(GALLANT).agent.symmetry


def test_it_observes_504_numbers_and_the_columns_and_nothing_waits_for_the_device(env: ManagerBasedRlEnv) -> None:
    shapes = {name: group.shape for name, group in env.observations.groups.items()}
    assert shapes == {"command": (4,), "proprioception": (384,), "last_actions": (116,), "voxels": (256,)}
    assert 4 + 384 + 116 == 504
    for _ in range(3):
        env.step(env.zeros(29))
    with no_host_sync(env):
        for _ in range(6):
            obs, reward, _, _ = env.step(0.1 * torch.ones(8, 29))
    assert reward.isfinite().all()
    assert obs["voxels"].isfinite().all()
    assert env.non_finite() == []


def test_uniform_noise_on_top_of_the_sensors_own_faults_is_refused(env: ManagerBasedRlEnv) -> None:
    group = build_task(GALLANT).env.observations.voxels
    group.terms.columns.noise = 0.1
    with pytest.raises(UserError, match="observation 'voxels.columns' has faults of its own; its noise must be 0"):
        ObservationGroup(env, "voxels", group)


def test_columns_see_the_ramp_ahead(env: ManagerBasedRlEnv) -> None:
    """The sensor on a real robot, against lookups below points of its own columns."""
    term = env.observations.groups["voxels"]._calls["columns"]
    term._position, term._turn = env.zeros(3), env.zeros(3)
    heights = term.scan(env)
    position = env.bodies.position("torso_link")
    rotation = env.bodies.rotation("torso_link")
    local = torch.cat([term._offsets.T.expand(8, -1, -1), heights[:, :, None]], dim=2)
    points = position[:, None] + local @ rotation.mT
    off = points[:, :, 2] - env.terrain.height(points[:, :, :2])
    inside = points[:, :, 0] > env.tiles.origin_w[:, :1]  # behind the tile's start the ground is that of its edge
    assert off[inside].abs().max() < 2e-3
    assert inside.float().mean() > 0.5


def test_a_robot_in_the_mirror_sees_the_mirror_image(env: ManagerBasedRlEnv) -> None:
    mirror = Mirror(env)
    columns = torch.arange(256.0).view(1, 16, 16)
    obs = TensorDict(
        {
            "command": torch.tensor([[1.0, 2.0, 3.0, 4.0]]),
            "proprioception": torch.randn(1, 384),
            "last_actions": torch.randn(1, 116),
            "voxels": columns.flatten(1),
        },
        batch_size=[1],
    )
    seen = mirror.observation(obs)
    assert seen["command"].tolist() == [[1.0, -2.0, 3.0, 4.0]]
    assert seen["voxels"].view(1, 16, 16).equal(columns.flip(2))  # rows run from right to left
    twice = mirror.observation(seen)
    assert all(twice[name].equal(obs[name]) for name in obs.keys())  # noqa: SIM118


def test_on_the_held_out_track_goals_lie_ahead_at_the_tracks_speed(
    make_stage1: Callable[..., ManagerBasedRlEnv],
) -> None:
    cfg = build_task(GALLANT)
    apply_preset(cfg, "cpu")
    protocol = HeldOutProtocol(grades=(10.0,), tiers=(0.6,), trials=2)
    scheduler = TrialScheduler(protocol, protocol.find_course(), 2)
    groups = ("command", "proprioception", "last_actions", "voxels")
    env = ManagerBasedRlEnv(held_out_env_cfg(cfg.env, scheduler, groups))
    goals = env.commands
    assert isinstance(goals, GoalCommand)
    assert goals.to_goal_w[:, 0].tolist() == pytest.approx([4.0, 4.0], abs=1e-5)
    assert (goals.goal_w[:, 1] - env.tiles.origin_w[:, 1]).abs().max() == 0.0
    assert env.commands.velocity[:, :2].tolist() == [[0.5, 0.0]] * 2
    x, y, elapsed, left = env.get_observations()["command"][0].tolist()
    # The torso stands some centimetres behind the pelvis, turned by up to 5 degrees.
    assert x == pytest.approx(4.0, abs=0.1)
    assert abs(y) < 0.5
    assert (elapsed, left) == (0.0, 10.0)


def test_the_sensors_faults_on_the_track_are_those_of_the_trial_alone() -> None:
    """A trial sees the same whatever runs beside it and whenever it runs."""
    cfg = build_task(GALLANT)
    apply_preset(cfg, "cpu")

    def seen(parallel: int) -> torch.Tensor:
        protocol = HeldOutProtocol(grades=(0.0,), tiers=(0.6,), trials=2)
        scheduler = TrialScheduler(protocol, protocol.find_course(), parallel)
        env = ManagerBasedRlEnv(held_out_env_cfg(cfg.env, scheduler, ("voxels",)))
        if parallel == 1:  # the first trial ends, the second begins later
            env.step(env.zeros(29))
            env.episode_length_buf = env.episode_length_buf + 7000
            env.step(env.zeros(29))
        return env.get_observations()["voxels"][-1]

    alone, beside = seen(1), seen(2)
    assert alone.equal(beside)
    assert (alone < -2.0).any()  # it has holes
