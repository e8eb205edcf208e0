"""The baseline from unitree_rl_mjlab has its published numbers, and everything else from Unitree RL Lab's."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from humoslope.cli.options import parse
from humoslope.cli.train import TrainArgs
from humoslope.env import ManagerBasedRlEnv
from humoslope.provenance import plain
from humoslope.registry import build_task
from robots.unitree_g1 import UNITREE_G1

MJLAB, URL, STAGE1 = "UnitreeMjlab-Rough-Unitree-G1", "URL-TerrainRelative-Unitree-G1", "HumoSlope-Stage1-Unitree-G1"
PAGE = Path(__file__).parents[2] / "docs" / "unitree_mjlab.md"

PUBLISHED = {
    "track_velocity": 1.0,
    "track_yaw_rate": 1.0,
    "flat_orientation": -5.0,
    "posture": 1.0,
    "torso_ang_vel_xy": -0.05,
    "angular_momentum": -0.025,
    "fall": -200.0,
    "joint_acc": -2.5e-7,
    "joint_limits": -10.0,
    "action_rate": -0.05,
    "step_time": 1.0,
    "foot_clearance": -1.0,
    "foot_slide": -0.25,
    "landing_force": -1e-3,
    "self_contact": -1.0,
}
"""unitree_rl_mjlab, `unitree_g1_rough_env_cfg` and the list that it inherits."""


@pytest.fixture(scope="module")
def env() -> ManagerBasedRlEnv:
    cfg = build_task(MJLAB).env
    cfg.num_envs, cfg.sim.backend = 2, "native"
    return ManagerBasedRlEnv(cfg)


def test_the_weights_are_the_published_ones_and_those_of_its_page() -> None:
    weights = {name: term.weight for name, term in build_task(MJLAB).env.rewards.items()}
    assert weights == PUBLISHED
    rows = re.findall(r"^\|[^|]*\| ([-\d.e]+) \| `(\w+)` \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert {name: float(weight) for weight, name in rows} == PUBLISHED


def test_it_differs_from_unitree_rl_labs_in_rewards_falls_and_what_the_critic_sees() -> None:
    own, theirs = plain(build_task(MJLAB)), plain(build_task(URL))
    assert own["start"] == theirs["start"]
    own, theirs = own["env"], theirs["env"]
    assert {name for name in own if own[name] != theirs[name]} == {"rewards", "observations", "terminations"}
    assert own["observations"]["actor"] == theirs["observations"]["actor"]
    ends = own["terminations"], theirs["terminations"]
    assert {name for name in ends[1] if ends[0][name] != ends[1][name]} == {"tilted"}
    assert ends[0]["tilted"]["params"] == {"degrees": 50.0}


def test_ppo_is_the_published_one() -> None:
    agent, url = build_task(MJLAB).agent, build_task(URL).agent
    assert agent.obs_normalization
    assert {k: v for k, v in vars(agent).items() if v != vars(url)[k]} == {"obs_normalization": True}


def test_its_actor_is_of_stage_1s_shape_and_its_critic_sees_velocity_too(env: ManagerBasedRlEnv) -> None:
    shapes = {name: group.shape for name, group in env.observations.groups.items()}
    assert shapes == {"actor": (480,), "critic": (99,)}
    own, ours = (plain(build_task(task))["env"]["observations"]["actor"] for task in (MJLAB, STAGE1))
    assert own == ours
    assert build_task(MJLAB).agent.obs_normalization == build_task(STAGE1).agent.obs_normalization


def test_a_step_earns_a_finite_reward_from_every_term(env: ManagerBasedRlEnv) -> None:
    for _ in range(3):
        _, reward, _, _ = env.step(env.zeros(29))
        assert reward.isfinite().all()
        assert env.rewards.last.isfinite().all()
    assert env.rewards.names == list(PUBLISHED)
    assert env.signals.com_ang_mom_w.norm(dim=1).min() > 0.0


def test_every_joint_has_its_published_tolerance(env: ManagerBasedRlEnv) -> None:
    params = build_task(MJLAB).env.rewards.posture.params
    loose = {"walking": {"hip_pitch", "knee"}, "running": {"hip_pitch", "knee"}}
    for gait, keys in loose.items():
        assert {key for key, value in params[gait].items() if value == 0.5} == keys
    middle = {"hip_roll", "hip_yaw", "ankle_pitch", "waist_yaw", "shoulder_pitch"}
    assert {k for k, v in params["walking"].items() if v == 0.15} == middle
    assert {k for k, v in params["running"].items() if v == 0.25} == middle
    assert all(sum(key in name for key in params["walking"]) == 1 for name in UNITREE_G1.joint_names)


def test_a_tolerance_is_an_option() -> None:
    options = ["--preset", "cpu", "--env.rewards.posture.params.walking.hip-pitch", "0.4"]
    cfg, _ = parse(TrainArgs(), MJLAB, options)
    assert cfg.env.rewards.posture.params["walking"]["hip_pitch"] == 0.4
    assert cfg.env.rewards.posture.params["running"]["hip_pitch"] == 0.5
