"""Stage I: learn to balance and walk, blind, on mixed slopes (paper, section 3.1).

Beyond the paper are the harness, the left/right symmetry augmentation of both stages (`AgentCfg.symmetry`), and the
number of every weight.
"""

from __future__ import annotations

import math

from humoslope.env import EnvCfg, SceneCfg
from humoslope.learning.config import PpoCfg
from humoslope.managers import (
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    TermCfg,
    TerminationTermCfg,
    Terms,
    VelocityCommandCfg,
)
from humoslope.mdp import curricula, events, harness, observations, rewards, terminations, zmp
from humoslope.registry import TaskCfg, task
from robots.unitree_g1 import UNITREE_G1
from terrains.stage1 import stage1 as stage1_terrain

# Scales and noise of Unitree RL Lab's velocity task.
PROPRIOCEPTION = {
    "base_ang_vel": (observations.base_ang_vel, 0.2, 0.2),
    "projected_gravity": (observations.projected_gravity, 0.05, 1.0),
    "velocity_command": (observations.velocity_command, 0.0, 1.0),
    "joint_pos_rel": (observations.joint_pos_rel, 0.01, 1.0),
    "joint_vel": (observations.joint_vel, 1.5, 0.05),
    "last_action": (observations.last_action, 0.0, 1.0),
}


def proprioception() -> Terms[ObservationTermCfg]:
    """Quantities that the robot measures itself; the actor observes nothing else."""
    return Terms(
        **{
            name: ObservationTermCfg(func, noise=noise, scale=scale)
            for name, (func, noise, scale) in PROPRIOCEPTION.items()
        }
    )


def actor_group() -> ObservationGroupCfg:
    """Noisy proprioception over five control steps."""
    return ObservationGroupCfg(terms=proprioception(), history=5, enable_corruption=True)


def critic_group() -> ObservationGroupCfg:
    """Proprioception without noise, and what only a simulator knows: velocity, contacts, friction, and the ground.

    The ground is the paper's H49 as in `observations.height_scan`. The paper does not say which stage's critic gets it;
    ours has it from Stage I on.
    """
    terms = proprioception()
    terms.base_lin_vel = ObservationTermCfg(observations.base_lin_vel)
    terms.foot_contact = ObservationTermCfg(observations.foot_contact)
    terms.foot_load = ObservationTermCfg(observations.foot_load)
    terms.foot_height = ObservationTermCfg(observations.foot_height, scale=5.0)
    terms.friction = ObservationTermCfg(observations.friction)
    terms.height_scan = ObservationTermCfg(observations.height_scan)
    return ObservationGroupCfg(terms=terms)


def base_rewards() -> Terms[RewardTermCfg]:
    """Rewards of both stages, per second. The list started from Unitree RL Lab's (`tasks/url.py`); the rest is ours.

    Changed terms: velocity and height refer to the ground; the pelvis may lean with the slope; time on one leg replaces
    a gait clock that the policy cannot observe; a fall costs; joint velocities do not. Of the weights only those of
    alive, angular velocity, energy, arm deviation, foot slide and body contact are Unitree's.
    """
    return Terms(
        track_velocity=RewardTermCfg(rewards.track_slope_velocity_exp, {"std": 0.35}, weight=2.0),
        track_yaw_rate=RewardTermCfg(rewards.track_yaw_rate_exp, {"std": 0.3}, weight=1.0),
        alive=RewardTermCfg(rewards.alive, weight=0.15),
        fall=RewardTermCfg(rewards.fall, weight=-100.0),
        slope_normal_velocity=RewardTermCfg(rewards.slope_normal_velocity_l2, weight=-1.0),
        ang_vel_xy=RewardTermCfg(rewards.ang_vel_xy_l2, weight=-0.05),
        roll=RewardTermCfg(rewards.roll_l2, weight=-3.0),
        pitch=RewardTermCfg(rewards.pitch_l2, {"slope_share": 0.7}, weight=-1.5),
        root_height=RewardTermCfg(rewards.root_height_l2, {"target": 0.75}, weight=-5.0),
        joint_acc=RewardTermCfg(rewards.JointAccelerationL2, weight=-2e-7),
        action_rate=RewardTermCfg(rewards.action_rate_l2, weight=-0.02),
        joint_limits=RewardTermCfg(rewards.joint_pos_limits, {"soft": 0.9}, weight=-3.0),
        energy=RewardTermCfg(rewards.energy, weight=-2e-5),
        arm_deviation=RewardTermCfg(rewards.joint_deviation_l1, {"joints": ".*(shoulder|elbow|wrist).*"}, weight=-0.1),
        waist_deviation=RewardTermCfg(rewards.joint_deviation_l1, {"joints": "waist.*"}, weight=-0.5),
        hip_deviation=RewardTermCfg(rewards.joint_deviation_l1, {"joints": ".*hip_(roll|yaw).*"}, weight=-0.5),
        single_stance=RewardTermCfg(rewards.SingleStance, {"cap": 0.4}, weight=1.5),
        foot_slide=RewardTermCfg(rewards.foot_slide, weight=-0.2),
        foot_clearance=RewardTermCfg(
            rewards.foot_clearance_exp, {"target": 0.08, "std": math.sqrt(0.02), "speed_scale": 2.0}, weight=0.5
        ),
        body_contact=RewardTermCfg(rewards.body_contact, {"force": 1.0}, weight=-1.0),
    )


def falls() -> Terms[TerminationTermCfg]:
    """Failures if the robot is down or about to be; time-outs at the end of the episode and at the edge of the tile."""
    return Terms(
        time_out=TerminationTermCfg(terminations.time_out, time_out=True),
        off_tile=TerminationTermCfg(terminations.off_tile, {"margin": 0.3}, time_out=True),
        root_too_low=TerminationTermCfg(terminations.root_too_low, {"height": 0.4}),
        tilted=TerminationTermCfg(terminations.tilted, {"degrees": 55.0}),
    )


def randomisation() -> Terms[EventTermCfg]:
    """Randomisation of the envs and of the starts of episodes, pushes, and the harness."""
    return Terms(
        mass=EventTermCfg(events.randomize_mass, {"body": "torso_link", "added": (-1.0, 3.0)}, mode="startup"),
        com=EventTermCfg(events.randomize_com, {"body": "torso_link", "offset": 0.03}, mode="startup"),
        gains=EventTermCfg(events.randomize_gains, {"stiffness": (0.9, 1.1), "damping": (0.9, 1.1)}, mode="startup"),
        friction=EventTermCfg(events.randomize_friction, {"friction": (0.3, 1.6), "slope_margin": 0.15}),
        root=EventTermCfg(events.ResetOnTile, {"along": (-0.15, 0.15), "across": (-0.5, 0.5), "yaw": (-0.3, 0.3)}),
        joints=EventTermCfg(events.reset_joints, {"position": (-0.05, 0.05), "velocity": (0.0, 0.0)}),
        push=EventTermCfg(events.push, {"speed": 0.5}, mode="interval", interval_s=(5.0, 8.0)),
        harness=EventTermCfg(harness.Harness, mode="step"),
    )


@task("HumoSlope-Stage1-Unitree-G1")
def stage1() -> TaskCfg:
    """Stage I: balance on mixed slopes with the slope-adaptive ZMP regulariser."""
    rewards_ = base_rewards()
    rewards_.zmp = RewardTermCfg(zmp.ZmpRegulariser, weight=0.5)
    return TaskCfg(
        env=EnvCfg(
            scene=SceneCfg(robot=UNITREE_G1, terrain=stage1_terrain()),
            command=VelocityCommandCfg(),
            observations=Terms(actor=actor_group(), critic=critic_group()),
            rewards=rewards_,
            terminations=falls(),
            events=randomisation(),
            curriculum=Terms(
                harness=TermCfg(harness.HarnessCurriculum),
                terrain_levels=TermCfg(curricula.TerrainLevels, {"harness": "harness"}),
            ),
        ),
        agent=PpoCfg(),
    )


@task("HumoSlope-Stage1-NoZMP-Unitree-G1")
def stage1_no_zmp() -> TaskCfg:
    """Ablation of Stage I: no ZMP regulariser."""
    cfg = stage1()
    cfg.env.rewards.zmp = None
    return cfg


@task("HumoSlope-Stage1-HorizontalZMP-Unitree-G1")
def stage1_horizontal_zmp() -> TaskCfg:
    """Ablation of Stage I: ZMP regulariser on the world-horizontal plane."""
    cfg = stage1()
    cfg.env.rewards.zmp.params["plane"] = "horizontal"
    return cfg
