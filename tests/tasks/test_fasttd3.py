"""The FastTD3 baselines differ from Unitree RL Lab's in what they say, and in nothing else."""

from __future__ import annotations

import re

import pytest

from humoslope.env import ManagerBasedRlEnv
from humoslope.learning.fasttd3.config import FastTd3Cfg
from humoslope.provenance import plain
from humoslope.registry import build_task
from robots.unitree_g1 import UNITREE_G1
from tasks.fasttd3 import HIPS_AND_KNEES, LEGS

ISAAC_LAB, RELATIVE, URL = (
    "FastTD3-IsaacLab-Unitree-G1",
    "FastTD3-TerrainRelative-Unitree-G1",
    "URL-TerrainRelative-Unitree-G1",
)

PUBLISHED = {
    "fall": -200.0,
    "track_velocity": 1.0,
    "track_yaw_rate": 2.0,
    "feet_air_time": 0.25,
    "foot_slide": -0.1,
    "ankle_limits": -1.0,
    "hip_deviation": -0.1,
    "arm_deviation": -0.1,
    "waist_deviation": -0.1,
    "ang_vel_xy": -0.05,
    "flat_orientation": -1.0,
    "joint_torques": -1.5e-7,
    "joint_acc": -1.25e-7,
    "action_rate": -0.005,
}
"""Isaac Lab, `config/g1/rough_env_cfg.py` and the list that it inherits."""


def test_only_the_algorithm_differs_from_unitrees_reward_over_the_ground() -> None:
    own, theirs = build_task(RELATIVE), build_task(URL)
    assert isinstance(own.agent, FastTd3Cfg)
    assert plain(own.env) == plain(theirs.env)
    assert own.start == theirs.start


def test_isaac_labs_differs_in_rewards_falls_and_what_the_critics_see() -> None:
    own, theirs = plain(build_task(ISAAC_LAB).env), plain(build_task(URL).env)
    assert {name for name in own if own[name] != theirs[name]} == {"rewards", "observations", "terminations"}
    assert own["observations"]["actor"] == theirs["observations"]["actor"]
    assert set(theirs["terminations"]) - set(own["terminations"]) == {"tilted"}
    assert set(own["terminations"]) - set(theirs["terminations"]) == {"upper_contact"}
    assert own["terminations"]["off_tile"] == theirs["terminations"]["off_tile"]


def test_the_weights_are_the_published_ones() -> None:
    cfg = build_task(ISAAC_LAB).env.rewards
    assert {name: term.weight for name, term in cfg.items()} == PUBLISHED
    assert (cfg.track_velocity.params["std"], cfg.track_yaw_rate.params["std"]) == (0.5, 0.5)
    assert cfg.feet_air_time.params["threshold"] == 0.4


@pytest.mark.parametrize(("pattern", "joints"), [(HIPS_AND_KNEES, 8), (LEGS, 12)])
def test_joints_are_those_that_isaac_lab_names(pattern: str, joints: int) -> None:
    hits = [name for name in UNITREE_G1.joint_names if re.fullmatch(pattern, name)]
    assert len(hits) == joints
    assert all("ankle" not in name for name in hits) == (pattern == HIPS_AND_KNEES)


def test_the_critics_see_what_isaac_labs_policy_does() -> None:
    cfg = build_task(ISAAC_LAB).env
    cfg.num_envs, cfg.sim.backend = 2, "native"
    env = ManagerBasedRlEnv(cfg)
    shapes = {name: group.shape for name, group in env.observations.groups.items()}
    assert shapes == {"actor": (480,), "critic": (3 + 96 + 49,)}
    _, reward, _, _ = env.step(env.zeros(29))
    assert reward.isfinite().all()
