"""Unitree's own MuJoCo task for the G1 on rough ground as a baseline: blind, and trained on slopes of up to 45 degrees.

Robot, gains, action scale, ground, friction, commands, randomisation, harness and the actor's observations are those of
`URL-TerrainRelative-Unitree-G1`, from which it starts, so that nothing can come apart. Rewards, the lean that is a
fall, what the critic sees and PPO's settings are those of unitree_rl_mjlab. What is kept, changed and left out is
listed row by row in docs/unitree_mjlab.md.

Its actor is of the same shape as Stage I's, so that it can start from an early checkpoint of Stage I (`--init`), as the
baselines in `tasks/url.py` do. With `--env.observations.actor.history 1` it is the published one, which sees one step.
"""

from __future__ import annotations

from humoslope.learning.config import PpoCfg
from humoslope.managers import RewardTermCfg, TerminationTermCfg, Terms
from humoslope.mdp import rewards, terminations, unitree_mjlab, unitree_rl_lab
from humoslope.registry import TaskCfg, task
from tasks.url import critic_group, url_terrain_relative

STANDING = 0.05
"""Distance of every joint from the default pose that standing tolerates, rad."""
WALKING = {
    "hip_pitch": 0.5,
    "hip_roll": 0.15,
    "hip_yaw": 0.15,
    "knee": 0.5,
    "ankle_pitch": 0.15,
    "ankle_roll": 0.1,
    "waist_yaw": 0.15,
    "waist_roll": 0.1,
    "waist_pitch": 0.1,
    "shoulder_pitch": 0.15,
    "shoulder_roll": 0.1,
    "shoulder_yaw": 0.1,
    "elbow": 0.1,
    "wrist": 0.1,
}
"""Distance that walking tolerates, rad."""
RUNNING = WALKING | {
    "hip_roll": 0.25,
    "hip_yaw": 0.25,
    "ankle_pitch": 0.25,
    "waist_yaw": 0.25,
    "shoulder_pitch": 0.25,
}
"""Distance that running tolerates, rad; no command here is fast enough unless `env.command.speed` says so."""


def unitree_mjlab_rewards() -> Terms[RewardTermCfg]:
    """The published list with its weights, per second."""
    posture = {"standing": STANDING, "walking": dict(WALKING), "running": dict(RUNNING)}
    return Terms(
        track_velocity=RewardTermCfg(unitree_mjlab.track_body_velocity_exp, {"std": 0.5}, weight=1.0),
        track_yaw_rate=RewardTermCfg(unitree_mjlab.track_body_turning_exp, {"std": 0.5}, weight=1.0),
        flat_orientation=RewardTermCfg(unitree_rl_lab.flat_orientation_l2, weight=-5.0),
        posture=RewardTermCfg(unitree_mjlab.PostureExp, posture, weight=1.0),
        torso_ang_vel_xy=RewardTermCfg(unitree_mjlab.torso_ang_vel_xy_l2, weight=-0.05),
        angular_momentum=RewardTermCfg(unitree_mjlab.angular_momentum_l2, weight=-0.025),
        fall=RewardTermCfg(rewards.fall, weight=-200.0),
        joint_acc=RewardTermCfg(rewards.JointAccelerationL2, weight=-2.5e-7),
        joint_limits=RewardTermCfg(rewards.joint_pos_limits, {"soft": 0.9}, weight=-10.0),
        action_rate=RewardTermCfg(rewards.action_rate_l2, weight=-0.05),
        step_time=RewardTermCfg(unitree_mjlab.StepTime, {"target": 0.3}, weight=1.0),
        foot_clearance=RewardTermCfg(unitree_mjlab.foot_clearance_l1, {"target": 0.1}, weight=-1.0),
        foot_slide=RewardTermCfg(unitree_mjlab.slip_l2, weight=-0.25),
        landing_force=RewardTermCfg(unitree_mjlab.LandingForce, weight=-1e-3),
        self_contact=RewardTermCfg(rewards.self_contact, {"force": 0.0}, weight=-1.0),
    )


@task("UnitreeMjlab-Rough-Unitree-G1")
def unitree_mjlab_rough() -> TaskCfg:
    """Baseline: the rewards of Unitree's MuJoCo task for the G1 on rough ground, heights taken over the ground."""
    cfg = url_terrain_relative()
    cfg.env.rewards = unitree_mjlab_rewards()
    cfg.env.observations.critic = critic_group()
    cfg.env.observations.critic.history = 1
    cfg.env.terminations.tilted = TerminationTermCfg(terminations.tilted, {"degrees": 50.0})
    cfg.agent = PpoCfg(init_std=1.0, symmetry=False, entropy_coef=0.01)
    return cfg
