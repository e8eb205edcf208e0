"""Unitree RL Lab's velocity task as a baseline: its rewards, observations, terminations and PPO on Stage I's worlds.

Robot, gains, action scale, ground, commands, randomisation and harness are Stage I's, so that the two differ in
rewards, observations of the critic, terminations and PPO only. Two departures from the published task: contacts of the
body count once a step, not once for each part that touches, since the ground force on everything but the feet is one
signal; and Unitree's command curriculum, which starts with commands around zero, is left out, because tiles are walked
in one direction, and the harness is withdrawn and levels are earned by walking.

Trained from scratch on a few million samples, these tasks learn to stand still. `--init` with an early checkpoint of
Stage I starts them from a policy that takes steps (experiments/log.md, "The baseline").
"""

from __future__ import annotations

import math

from humoslope.env import EnvCfg, SceneCfg
from humoslope.learning.config import PpoCfg
from humoslope.managers import (
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    TermCfg,
    TerminationTermCfg,
    Terms,
)
from humoslope.mdp import curricula, harness, observations, rewards, terminations, unitree_rl_lab
from humoslope.registry import TaskCfg, task
from robots.unitree_g1 import UNITREE_G1_SOLID
from robots.unitree_g1.model import SOLE_CENTRE
from tasks.stage1 import actor_group, all_directions, falls, harness_curriculum, physics, proprioception, randomisation
from terrains.stage1 import stage1 as stage1_terrain

ROOT_HEIGHT = {"target": 0.78}
"""Target height of the root, m."""
LOWEST_ROOT = {"height": 0.2}
"""Height of the root below which the robot has fallen, m."""
CLEARANCE = {"target": 0.1 + SOLE_CENTRE[2], "std": math.sqrt(0.05), "speed_scale": 2.0}
"""Target height of the sole, m: Unitree's "foot height" is that of the ankle, with a target of 0.1 m."""


def critic_group() -> ObservationGroupCfg:
    """Velocity and the actor's observations without noise, over the same number of steps."""
    terms = {"base_lin_vel": ObservationTermCfg(observations.base_lin_vel)} | dict(proprioception().items())
    return ObservationGroupCfg(terms=Terms(**terms), history=5)


def url_rewards() -> Terms[RewardTermCfg]:
    """The published list with its weights, per second (July 2025, see `mdp/unitree_rl_lab.py`)."""
    return Terms(
        track_velocity=RewardTermCfg(unitree_rl_lab.track_horizontal_velocity_exp, {"std": 0.5}, weight=1.0),
        track_yaw_rate=RewardTermCfg(unitree_rl_lab.track_body_yaw_rate_exp, {"std": 0.5}, weight=0.5),
        alive=RewardTermCfg(rewards.alive, weight=0.15),
        lin_vel_z=RewardTermCfg(unitree_rl_lab.lin_vel_z_l2, weight=-2.0),
        ang_vel_xy=RewardTermCfg(rewards.ang_vel_xy_l2, weight=-0.05),
        joint_vel=RewardTermCfg(unitree_rl_lab.joint_vel_l2, weight=-1e-3),
        joint_acc=RewardTermCfg(rewards.JointAccelerationL2, weight=-2.5e-7),
        action_rate=RewardTermCfg(rewards.action_rate_l2, weight=-0.05),
        joint_limits=RewardTermCfg(rewards.joint_pos_limits, {"soft": 0.9}, weight=-5.0),
        energy=RewardTermCfg(rewards.energy, weight=-2e-5),
        arm_deviation=RewardTermCfg(rewards.joint_deviation_l1, {"joints": ".*(shoulder|elbow|wrist).*"}, weight=-0.1),
        waist_deviation=RewardTermCfg(rewards.joint_deviation_l1, {"joints": "waist.*"}, weight=-1.0),
        hip_deviation=RewardTermCfg(rewards.joint_deviation_l1, {"joints": ".*hip_(roll|yaw).*"}, weight=-1.0),
        flat_orientation=RewardTermCfg(unitree_rl_lab.flat_orientation_l2, weight=-5.0),
        root_height=RewardTermCfg(unitree_rl_lab.base_height_world_l2, dict(ROOT_HEIGHT), weight=-10.0),
        gait=RewardTermCfg(
            unitree_rl_lab.gait_clock, {"period": 0.8, "stance_share": 0.55, "least_command": 0.1}, weight=0.5
        ),
        foot_slide=RewardTermCfg(unitree_rl_lab.foot_slide_horizontal, weight=-0.2),
        foot_clearance=RewardTermCfg(unitree_rl_lab.foot_clearance_world_exp, dict(CLEARANCE), weight=1.0),
        body_contact=RewardTermCfg(rewards.body_contact, {"force": 1.0}, weight=-1.0),
    )


@task("URL-Literal-Unitree-G1")
def url_literal() -> TaskCfg:
    """Baseline: Unitree RL Lab's rewards as published, heights in the world frame."""
    ends = falls()
    ends.root_too_low = TerminationTermCfg(unitree_rl_lab.root_too_low_in_world, dict(LOWEST_ROOT))
    ends.tilted = TerminationTermCfg(terminations.tilted, {"degrees": math.degrees(0.8)})
    return TaskCfg(
        env=EnvCfg(
            scene=SceneCfg(robot=UNITREE_G1_SOLID, terrain=stage1_terrain()),
            sim=physics(),
            command=all_directions(),
            observations=Terms(actor=actor_group(), critic=critic_group()),
            rewards=url_rewards(),
            terminations=ends,
            events=randomisation(),
            curriculum=Terms(
                harness=harness_curriculum(),
                skills=TermCfg(harness.SkillCurriculum),
                terrain_levels=TermCfg(curricula.TerrainLevels, {"harness": "harness"}),
            ),
        ),
        agent=PpoCfg(init_std=1.0, obs_normalization=False, symmetry=False, entropy_coef=0.01),
    )


@task("URL-TerrainRelative-Unitree-G1")
def url_terrain_relative() -> TaskCfg:
    """Baseline: Unitree RL Lab's rewards with heights of root and feet taken over the ground."""
    cfg = url_literal()
    cfg.env.rewards.root_height = RewardTermCfg(rewards.root_height_l2, dict(ROOT_HEIGHT), weight=-10.0)
    cfg.env.rewards.foot_clearance = RewardTermCfg(rewards.foot_clearance_exp, dict(CLEARANCE), weight=1.0)
    cfg.env.terminations.root_too_low = TerminationTermCfg(terminations.root_too_low, dict(LOWEST_ROOT))
    return cfg
