"""Gallant, re-implemented: a policy that sees the ground around it, rewarded for reaching goals (arXiv 2511.14625).

Robot, gains, action scale, ground, friction, randomisation and harness are those of the baselines in `tasks/url.py`.
What is the original's, what differs and what is missing is listed row by row in docs/gallant.md. The numbers were
published without a licence, so that everything here is written anew.
"""

from __future__ import annotations

import math

from humoslope.env import EnvCfg, SceneCfg
from humoslope.learning.gallant.config import GallantCfg
from humoslope.managers import (
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    TermCfg,
    TerminationTermCfg,
    Terms,
)
from humoslope.managers.goal import GoalCommandCfg
from humoslope.mdp import curricula, gallant, rewards, terminations, unitree_rl_lab, voxels
from humoslope.registry import TaskCfg, task
from robots.unitree_g1 import UNITREE_G1_SOLID
from tasks.stage1 import falls, harness_curriculum, physics, proprioception, randomisation
from terrains.stage1 import stage1 as stage1_terrain

PROPRIOCEPTION = ("base_ang_vel", "projected_gravity", "joint_pos_rel", "joint_vel")
HEAD = 1.32
"""Height of the head over open ground, m."""
DEVIATIONS = {
    "hip_yaw": (".*_hip_yaw_joint", 0.5),
    "hip_roll": (".*_hip_roll_joint", 1.0),
    "hip_pitch": (".*_hip_pitch_joint", 0.05),
    "knee": (".*_knee_joint", 0.02),
    "ankle_pitch": (".*_ankle_pitch_joint", 0.1),
    "ankle_roll": (".*_ankle_roll_joint", 1.5),
    "waist_roll_yaw": ("waist_(roll|yaw)_joint", 1.0),
    "waist_pitch": ("waist_pitch_joint", 0.5),
    "arm_roll_yaw": (".*_shoulder_(roll|yaw)_joint", 1.0),
    "arm": (".*_(shoulder_pitch|elbow)_joint", 0.5),
    "wrist": (".*_wrist_.*", 1.0),
}
"""Joints that should stay close to the default pose, and the price of a squared distance, 1/(s rad^2)."""


def observation_groups() -> Terms[ObservationGroupCfg]:
    """What actor and critic see: the goal, proprioception of six steps, four actions, and the voxel columns.

    Proprioception is what Stage I's actor sees, with its noise and its age.
    """
    known = proprioception()
    sensed = Terms(**{name: known[name] for name in PROPRIOCEPTION})
    for name in PROPRIOCEPTION:
        sensed[name].params["measured"] = True
    return Terms(
        command=ObservationGroupCfg(terms=Terms(goal=ObservationTermCfg(gallant.goal_command))),
        proprioception=ObservationGroupCfg(terms=sensed, history=6, enable_corruption=True),
        last_actions=ObservationGroupCfg(terms=Terms(last_action=known.last_action), history=4),
        voxels=ObservationGroupCfg(
            terms=Terms(columns=ObservationTermCfg(voxels.VoxelColumns, {"cell": voxels.FULL})), enable_corruption=True
        ),
    )


def gallant_rewards() -> Terms[RewardTermCfg]:
    """The published list with its weights, per second; the learner clips their sum at 0 from below.

    Its three contact penalties are one here, at the highest of their weights.
    """
    deviations = {
        f"{name}_deviation": RewardTermCfg(gallant.joint_deviation_l2, {"joints": joints}, weight=-price)
        for name, (joints, price) in DEVIATIONS.items()
    }
    apart = (0.2, 0.28)  # m
    feet = {"lefts": ("left_ankle_roll_link",), "rights": ("right_ankle_roll_link",), "span": apart}
    legs = {
        "lefts": ("left_hip_yaw_link", "left_knee_link"),
        "rights": ("right_hip_yaw_link", "right_knee_link"),
        "span": apart,
    }
    return Terms(
        velocity_direction=RewardTermCfg(gallant.velocity_direction, weight=2.0),
        reach_goal=RewardTermCfg(gallant.reach_goal, weight=2.0),
        at_goal=RewardTermCfg(gallant.at_goal, weight=1.0),
        heading=RewardTermCfg(gallant.heading_off_goal, weight=-3.0),
        pace=RewardTermCfg(gallant.off_pace, {"pace": (0.4, 0.8)}, weight=-1.0),
        stance=RewardTermCfg(gallant.stance, weight=2.0),
        head_height=RewardTermCfg(gallant.head_height, {"target": HEAD}, weight=1.5),
        torso_lean=RewardTermCfg(gallant.torso_lean, weight=-0.5),
        pelvis_lean=RewardTermCfg(gallant.pelvis_lean, weight=-1.0),
        body_force=RewardTermCfg(gallant.body_force, weight=-1.0),
        sole_points=RewardTermCfg(gallant.SolePointsDown, {"near": 0.035}, weight=1.5),
        slip=RewardTermCfg(gallant.slip_l2, weight=-1.0),
        low_swing=RewardTermCfg(gallant.low_swing, {"target": 0.05, "ahead": 0.15}, weight=-1.5),
        pitched_feet=RewardTermCfg(gallant.PitchedLiftOff, weight=-0.1),
        lin_vel_z=RewardTermCfg(gallant.lin_vel_z_l2, weight=-0.5),
        ang_vel_xy=RewardTermCfg(rewards.ang_vel_xy_l2, weight=-0.05),
        action_rate=RewardTermCfg(rewards.action_rate_l2, weight=-0.01),
        action_acc=RewardTermCfg(rewards.ActionAccelerationL2, weight=-0.005),
        **deviations,
        joint_acc=RewardTermCfg(rewards.JointAccelerationL2, weight=-2.5e-7),
        joint_limits=RewardTermCfg(rewards.joint_pos_limits, {"soft": 0.9}, weight=-1.0),
        feet_apart=RewardTermCfg(gallant.lateral_distance, feet, weight=-1.5),
        legs_apart=RewardTermCfg(gallant.lateral_distance, legs, weight=-1.5),
        feet_parallel=RewardTermCfg(gallant.feet_apart_in_yaw, weight=-1.0),
        power=RewardTermCfg(gallant.power_l2, weight=-2e-4),
        stumble=RewardTermCfg(gallant.stumble, weight=-1.0),
        torques=RewardTermCfg(gallant.torque_over_stiffness_l2, weight=-2.5e-6),
        joint_vel=RewardTermCfg(unitree_rl_lab.joint_vel_l2, weight=-1e-4),
        fast_joints=RewardTermCfg(gallant.FastJoints, {"share": 0.8}, weight=-2e-3),
        strong_joints=RewardTermCfg(gallant.StrongJoints, {"share": 0.95}, weight=-0.01),
        heavy_feet=RewardTermCfg(gallant.heavy_feet, {"free": 250.0}, weight=-1e-6),
        landing=RewardTermCfg(gallant.landing_momentum, {"free": 50.0}, weight=-2.5e-4),
    )


def ends() -> Terms[TerminationTermCfg]:
    """The published terminations, beside the time-outs of the other tasks and their least height of the root."""
    terms = falls()
    terms.tilted = TerminationTermCfg(terminations.tilted, {"degrees": math.degrees(math.asin(0.8))})
    terms.hit = TerminationTermCfg(gallant.hit, {"force": 100.0})
    terms.feet_too_close = TerminationTermCfg(gallant.feet_too_close, {"distance": 0.05})
    terms.not_moving = TerminationTermCfg(gallant.not_moving, {"distance": 1.0, "seconds": 4.0})
    return terms


@task("Gallant-Unitree-G1")
def gallant_task() -> TaskCfg:
    """Baseline: Gallant, re-implemented; it sees the ground in voxels and walks to goals."""
    return TaskCfg(
        env=EnvCfg(
            scene=SceneCfg(robot=UNITREE_G1_SOLID, terrain=stage1_terrain()),
            sim=physics(),
            command=GoalCommandCfg(),
            observations=observation_groups(),
            rewards=gallant_rewards(),
            terminations=ends(),
            events=randomisation(),
            curriculum=Terms(
                harness=harness_curriculum(),
                terrain_levels=TermCfg(curricula.TerrainLevels, {"harness": "harness"}),
            ),
        ),
        agent=GallantCfg(),
    )
