"""FastTD3 as a baseline, on the worlds of the baselines in `tasks/url.py`.

Robot, gains, action scale, ground, friction, commands, randomisation, harness and the actor's observations are those of
`URL-TerrainRelative-Unitree-G1`, from which both tasks start, so that nothing can come apart. FastTD3 has no reward of
its own; its authors work in Isaac Lab with what they find there.

| task | rewards and terminations | the critics see |
|---|---|---|
| FastTD3-IsaacLab | of Isaac Lab's `Isaac-Velocity-Rough-G1-v0` | what that task observes, without noise |
| FastTD3-TerrainRelative | of URL-TerrainRelative: only the algorithm differs | as there |

Departures from Isaac Lab's task, beside worlds, robot and commands: the robot has wrists and no fingers; the height
scan is the 49 heights that Stage I's critic sees; a fall is contact of anything but feet and shins, not of the torso
alone, or a root lower than in URL-TerrainRelative, by which `humoslope play` counts falls; and an episode is cut off at
the edge of a tile.
"""

from __future__ import annotations

from humoslope.learning.fasttd3.config import FastTd3Cfg
from humoslope.managers import ObservationGroupCfg, ObservationTermCfg, RewardTermCfg, TerminationTermCfg, Terms
from humoslope.mdp import isaac_lab, observations, rewards, unitree_rl_lab
from humoslope.registry import TaskCfg, task
from tasks.stage1 import proprioception
from tasks.url import url_terrain_relative

HIPS_AND_KNEES = ".*_(hip_pitch|hip_roll|hip_yaw|knee)_joint"
LEGS = ".*_(hip_pitch|hip_roll|hip_yaw|knee|ankle_pitch|ankle_roll)_joint"


def isaac_lab_critic_group() -> ObservationGroupCfg:
    """Observations of Isaac Lab's task, among them velocity and height scan, which a blind actor does not have."""
    terms = {"base_lin_vel": ObservationTermCfg(observations.base_lin_vel)} | dict(proprioception().items())
    terms["height_scan"] = ObservationTermCfg(observations.height_scan)
    return ObservationGroupCfg(terms=Terms(**terms))


def isaac_lab_rewards() -> Terms[RewardTermCfg]:
    """The published list with its weights, per second; terms of weight 0 and those of the fingers are left out."""
    deviation = rewards.joint_deviation_l1
    return Terms(
        fall=RewardTermCfg(rewards.fall, weight=-200.0),
        track_velocity=RewardTermCfg(unitree_rl_lab.track_horizontal_velocity_exp, {"std": 0.5}, weight=1.0),
        track_yaw_rate=RewardTermCfg(rewards.track_yaw_rate_exp, {"std": 0.5}, weight=2.0),
        feet_air_time=RewardTermCfg(isaac_lab.FeetAirTime, {"threshold": 0.4}, weight=0.25),
        foot_slide=RewardTermCfg(unitree_rl_lab.foot_slide_horizontal, weight=-0.1),
        ankle_limits=RewardTermCfg(rewards.joint_pos_limits, {"soft": 0.9, "joints": ".*_ankle_.*"}, weight=-1.0),
        hip_deviation=RewardTermCfg(deviation, {"joints": ".*_hip_(roll|yaw)_joint"}, weight=-0.1),
        arm_deviation=RewardTermCfg(deviation, {"joints": ".*(shoulder|elbow|wrist).*"}, weight=-0.1),
        waist_deviation=RewardTermCfg(deviation, {"joints": "waist.*"}, weight=-0.1),
        ang_vel_xy=RewardTermCfg(rewards.ang_vel_xy_l2, weight=-0.05),
        flat_orientation=RewardTermCfg(unitree_rl_lab.flat_orientation_l2, weight=-1.0),
        joint_torques=RewardTermCfg(isaac_lab.joint_torques_l2, {"joints": LEGS}, weight=-1.5e-7),
        joint_acc=RewardTermCfg(rewards.JointAccelerationL2, {"joints": HIPS_AND_KNEES}, weight=-1.25e-7),
        action_rate=RewardTermCfg(rewards.action_rate_l2, weight=-0.005),
    )


@task("FastTD3-TerrainRelative-Unitree-G1")
def fasttd3_terrain_relative() -> TaskCfg:
    """Baseline: FastTD3 in place of PPO on the worlds and rewards of URL-TerrainRelative."""
    cfg = url_terrain_relative()
    cfg.agent = FastTd3Cfg()
    return cfg


@task("FastTD3-IsaacLab-Unitree-G1")
def fasttd3_isaac_lab() -> TaskCfg:
    """Baseline: FastTD3 with the rewards of Isaac Lab's task for the G1 on rough ground."""
    cfg = fasttd3_terrain_relative()
    cfg.env.rewards = isaac_lab_rewards()
    cfg.env.observations.critic = isaac_lab_critic_group()
    cfg.env.terminations.tilted = None
    cfg.env.terminations.upper_contact = TerminationTermCfg(isaac_lab.upper_contact, {"force": 1.0})
    return cfg
