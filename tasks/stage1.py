"""Stage I: learn to balance and walk, blind, on mixed slopes (paper, section 3.1).

Beyond the paper are the harness, the left/right symmetry augmentation of both stages (`AgentCfg.symmetry`), and the
number of every weight.
"""

from __future__ import annotations

import math
from typing import Any

from humoslope.env import EnvCfg, SceneCfg, SimCfg
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
from humoslope.mdp import (
    curricula,
    events,
    harness,
    observations,
    randomization,
    rewards,
    standing,
    terminations,
    zmp,
)
from humoslope.registry import TaskCfg, task
from robots.unitree_g1 import UNITREE_G1_SOLID
from terrains.stage1 import stage1 as stage1_terrain

AGE = 0.01
"""Least age of what the policy sees, s: a reading of the last 10 ms, as on the robot."""
LATEST = 0.02
"""Longest delay from a decision to the motors, s."""

# Scales and noise of Unitree RL Lab's velocity task.
PROPRIOCEPTION = {
    "base_ang_vel": (observations.base_ang_vel, 0.2, 0.2),
    "projected_gravity": (observations.projected_gravity, 0.05, 1.0),
    "velocity_command": (observations.velocity_command, 0.0, 1.0),
    "joint_pos_rel": (observations.joint_pos_rel, 0.01, 1.0),
    "joint_vel": (observations.joint_vel, 1.5, 0.05),
    "last_action": (observations.last_action, 0.0, 1.0),
}


SENSED = ("base_ang_vel", "projected_gravity", "joint_pos_rel", "joint_vel")
"""Observations that sensors report, with their errors and at their age."""


def proprioception() -> Terms[ObservationTermCfg]:
    """Quantities that the robot measures itself; the actor observes nothing else."""
    return Terms(
        **{
            name: ObservationTermCfg(func, noise=noise, scale=scale)
            for name, (func, noise, scale) in PROPRIOCEPTION.items()
        }
    )


def actor_group() -> ObservationGroupCfg:
    """Proprioception as the sensors report it, with noise, over five control steps."""
    terms = proprioception()
    for name in SENSED:
        terms[name].params["measured"] = True
    return ObservationGroupCfg(terms=terms, history=5, enable_corruption=True)


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
    alive, angular velocity, energy and body contact are Unitree's. Speed has a second, narrower reward, for robots that
    walk already.
    """
    return Terms(
        track_velocity=RewardTermCfg(rewards.track_slope_velocity_exp, {"std": 0.35}, weight=2.0),
        track_velocity_finely=RewardTermCfg(rewards.track_slope_velocity_exp, {"std": 0.25}, weight=2.0),
        track_yaw_rate=RewardTermCfg(rewards.TrackMeanYawRate, {"std": 0.35, "memory_s": 0.4}, weight=3.0),
        alive=RewardTermCfg(rewards.alive, weight=0.15),
        fall=RewardTermCfg(rewards.fall, weight=-100.0),
        slope_normal_velocity=RewardTermCfg(rewards.slope_normal_velocity_l2, weight=-1.0),
        ang_vel_xy=RewardTermCfg(rewards.ang_vel_xy_l2, weight=-0.05),
        roll=RewardTermCfg(rewards.roll_l2, weight=-3.0),
        pitch=RewardTermCfg(rewards.pitch_l2, {"slope_share": 0.7}, weight=-1.5),
        root_height=RewardTermCfg(rewards.root_height_l2, {"target": 0.76}, weight=-5.0),
        knee_flexion=RewardTermCfg(rewards.knee_flexion_l1, {"free": 0.4}, weight=-0.5),
        joint_acc=RewardTermCfg(rewards.JointAccelerationL2, weight=-2e-7),
        action_rate=RewardTermCfg(rewards.action_rate_l2, weight=-0.02),
        action_acc=RewardTermCfg(rewards.ActionAccelerationL2, weight=-0.01),
        joint_limits=RewardTermCfg(rewards.joint_pos_limits, {"soft": 0.9}, weight=-3.0),
        energy=RewardTermCfg(rewards.energy, weight=-2e-5),
        arm_deviation=RewardTermCfg(rewards.joint_deviation_l1, {"joints": ".*(shoulder|elbow|wrist).*"}, weight=-0.2),
        waist_deviation=RewardTermCfg(rewards.joint_deviation_l1, {"joints": "waist.*"}, weight=-0.5),
        hip_deviation=RewardTermCfg(rewards.joint_deviation_l1, {"joints": ".*hip_(roll|yaw).*"}, weight=-0.5),
        single_stance=RewardTermCfg(rewards.SingleStance, {"cap": 0.4, "transfer": 0.08}, weight=3.0),
        landings=RewardTermCfg(rewards.LandingRate, weight=-0.2),
        foot_slide=RewardTermCfg(rewards.foot_slide, weight=-0.2),
        foot_clearance=RewardTermCfg(
            rewards.foot_clearance_exp, {"target": 0.08, "std": math.sqrt(0.02), "speed_scale": 2.0}, weight=0.5
        ),
        body_contact=RewardTermCfg(rewards.body_contact, {"force": 1.0}, weight=-1.0),
        self_contact=RewardTermCfg(rewards.self_contact, {"force": 1.0}, weight=-1.0),
        stand_on_both_feet=RewardTermCfg(standing.both_feet_down, weight=1.0),
        stand_without_steps=RewardTermCfg(standing.foot_speed, weight=-1.0),
        stand_without_creep=RewardTermCfg(standing.creep, weight=-2.0),
        stand_at_ease=RewardTermCfg(standing.posture_l1, weight=-0.1),
    )


def all_directions(**changes: Any) -> VelocityCommandCfg:
    """Commands to walk forward, and on hillsides backward, to the sides and turning in place too; and to stand."""
    return VelocityCommandCfg(
        yaw_rate=(-0.6, 0.6),
        standing_share=0.2,
        resample_s=(4.0, 10.0),
        modes={"forward": 0.1, "backward": 0.3, "sideways": 0.3, "turning": 0.3},
        backward=(0.2, 0.5),
        sideways=(0.2, 0.5),
        **changes,
    )


FINE = ("track_velocity_finely",)
"""Rewards for following commands closely, which grow as the harness goes and commands vary."""

STRICT = ("knee_flexion", "foot_clearance", "action_acc", "landings")
"""Rewards that count when the harness is gone: a robot must first of all find out that it can walk."""


def harness_curriculum() -> TermCfg:
    """The harness goes where robots hardly fall and walk at 60 % of the commanded speed; then more is asked of them."""
    return TermCfg(harness.HarnessCurriculum, {"speed_share": 0.6})


def falls() -> Terms[TerminationTermCfg]:
    """Failures if the robot is down or about to be; time-outs at the end of the episode and at the edge of the tile."""
    return Terms(
        time_out=TerminationTermCfg(terminations.time_out, time_out=True),
        off_tile=TerminationTermCfg(terminations.off_tile, {"margin": 0.3}, time_out=True),
        root_too_low=TerminationTermCfg(terminations.root_too_low, {"height": 0.4}),
        tilted=TerminationTermCfg(terminations.tilted, {"degrees": 55.0}),
    )


def randomisation() -> Terms[EventTermCfg]:
    """Randomisation of the envs and of the starts of episodes, pushes, and the harness.

    The ranges are meant to hold what a robot may differ by from its model; `humoslope margins` measures how far a
    policy really carries.
    """
    return Terms(
        mass=EventTermCfg(events.randomize_mass, {"body": "torso_link", "added": (-1.0, 3.0)}, mode="startup"),
        com=EventTermCfg(events.randomize_com, {"body": "torso_link", "offset": 0.03}, mode="startup"),
        link_masses=EventTermCfg(randomization.randomize_link_masses, {"factor": (0.9, 1.1)}, mode="startup"),
        gains=EventTermCfg(events.randomize_gains, {"stiffness": (0.9, 1.1), "damping": (0.9, 1.1)}, mode="startup"),
        strength=EventTermCfg(randomization.randomize_motor_strength, {"strength": (0.8, 1.2)}, mode="startup"),
        armature=EventTermCfg(randomization.randomize_armature, {"factor": (0.9, 1.1)}, mode="startup"),
        joint_damping=EventTermCfg(randomization.randomize_joint_damping, {"damping": (0.0, 0.3)}, mode="startup"),
        encoders=EventTermCfg(randomization.randomize_encoder_bias, {"bias": 0.02}, mode="startup"),
        imu_mounting=EventTermCfg(randomization.randomize_imu_mounting, {"tilt": 0.07}, mode="startup"),
        contact_softness=EventTermCfg(
            randomization.randomize_contact_softness, {"time_constant": (0.02, 0.025)}, mode="startup"
        ),
        gyro_bias=EventTermCfg(randomization.randomize_gyro_bias, {"bias": 0.05}),
        control_delay=EventTermCfg(randomization.randomize_control_delay, {"delay": (0.0, LATEST)}),
        observation_age=EventTermCfg(randomization.randomize_observation_age, {"age": (AGE, 2.0 * AGE)}),
        friction=EventTermCfg(events.randomize_friction, {"friction": (0.3, 1.6), "slope_margin": 0.15}),
        root=EventTermCfg(events.ResetOnTile, {"along": (-0.15, 0.15), "across": (-0.5, 0.5), "yaw": (-0.3, 0.3)}),
        joints=EventTermCfg(events.reset_joints, {"position": (-0.05, 0.05), "velocity": (0.0, 0.0)}),
        push=EventTermCfg(
            events.push, {"speed": 1.0, "harness": "harness", "full_level": 8}, mode="interval", interval_s=(5.0, 8.0)
        ),
        harness=EventTermCfg(harness.Harness, {"support": 0.5}, mode="step"),
    )


def physics() -> SimCfg:
    """Physics with room for delays; what the policy sees is as old at any physics step."""
    return SimCfg(observation_age_s=AGE, max_control_delay_s=LATEST)


@task("HumoSlope-Stage1-Unitree-G1")
def stage1() -> TaskCfg:
    """Stage I: balance on mixed slopes with the slope-adaptive ZMP regulariser."""
    rewards_ = base_rewards()
    rewards_.zmp = RewardTermCfg(zmp.ZmpRegulariser, weight=0.5)
    return TaskCfg(
        env=EnvCfg(
            scene=SceneCfg(robot=UNITREE_G1_SOLID, terrain=stage1_terrain()),
            sim=physics(),
            command=all_directions(),
            observations=Terms(actor=actor_group(), critic=critic_group()),
            rewards=rewards_,
            terminations=falls(),
            events=randomisation(),
            curriculum=Terms(
                harness=harness_curriculum(),
                skills=TermCfg(harness.SkillCurriculum),
                fine_rewards=TermCfg(harness.StrengthenRewards, {"rewards": FINE, "by": "withdrawn"}),
                strict_rewards=TermCfg(harness.StrengthenRewards, {"rewards": STRICT}),
                terrain_levels=TermCfg(curricula.TerrainLevels, {"harness": "harness"}),
            ),
        ),
        agent=PpoCfg(max_iterations=5000, entropy_coef=0.002, final_entropy_coef=0.0002),
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
