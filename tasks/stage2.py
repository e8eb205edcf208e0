"""Stage II: from Stage I's actor to a gait that fits the slope (paper, section 3.2), and the ablations of the method.

| paper's variant | task | starts from | critic sees the descriptor | BSGA rewards |
|---|---|---|---|---|
| full | Stage2 | Stage1 | yes | yes |
| Stage I only | Stage1 | - | - | - |
| without slope-adaptive ZMP | Stage2-NoZMP | Stage1-NoZMP | yes | yes |
| without BSGA critic cue | Stage2-NoCriticCue | Stage1 | no | yes |
| without BSGA reward priors | Stage2-NoRewardPriors | Stage1 | yes | no |
| without BSGA | Stage2-NoBSGA | Stage1 | no | no |

Without BSGA rewards the CoM has the base list's fixed reference height, as in Stage I.
"""

from __future__ import annotations

from humoslope.env import EnvCfg, SceneCfg
from humoslope.learning.config import PpoCfg
from humoslope.managers import (
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    TermCfg,
    Terms,
)
from humoslope.mdp import bsga, curricula, observations
from humoslope.mdp.bsga_memory import SlopeGait
from humoslope.registry import TaskCfg, WarmStartCfg, task
from humoslope.slope.bsga import branch_weights
from humoslope.slope.swing import PRIOR
from robots.unitree_g1 import UNITREE_G1_SOLID
from tasks.stage1 import (
    actor_group,
    all_directions,
    base_rewards,
    critic_group,
    falls,
    physics,
    randomisation,
)
from terrains.stage2 import stage2 as stage2_terrain


def critic_with_cue() -> ObservationGroupCfg:
    """Stage I's critic with the terrain descriptor added.

    The scan H49 is in Stage I's critic already; the paper has both in that of Stage II.
    """
    group = critic_group()
    group.terms.terrain_descriptor = ObservationTermCfg(observations.terrain_descriptor)
    return group


def walking_rewards() -> Terms[RewardTermCfg]:
    """Stage I's base list, in which arms cost more: at less they were raised to earn r_com (experiments/log.md)."""
    rewards = base_rewards()
    rewards.arm_deviation.weight = -0.5
    return rewards


def rewards_with_bsga() -> Terms[RewardTermCfg]:
    """The base list without its fixed height, with BSGA's five terms in the paper's sum; its numbers are ours."""
    rewards = walking_rewards()
    rewards.root_height = rewards.knee_flexion = None  # r_com rewards a height that fits the slope
    weight = branch_weights()
    swing = {"beta0": PRIOR.beta0, "beta1": PRIOR.beta1, "theta_clip": PRIOR.theta_clip}
    rewards.com_height = RewardTermCfg(bsga.ComHeight, {"nominal": 0.69}, weight=weight.com)
    rewards.hip_propulsion = RewardTermCfg(bsga.HipPropulsion, weight=weight.hip)
    rewards.knee_braking = RewardTermCfg(bsga.KneeBraking, weight=weight.brake)
    rewards.stride = RewardTermCfg(bsga.Stride, weight=weight.stride)
    rewards.swing_hip = RewardTermCfg(bsga.SwingHip, swing, weight=weight.swing)
    return rewards


def unaided() -> Terms[EventTermCfg]:
    """Stage I's randomisation without the harness, as the actor can walk."""
    events = randomisation()
    events.harness = None
    events.push.params = {"speed": events.push.params["speed"]}  # in full, wherever it walks
    return events


@task("HumoSlope-Stage2-Unitree-G1")
def stage2() -> TaskCfg:
    """Stage II: adapt posture and gait on slope tracks, guided by the terrain descriptor."""
    return TaskCfg(
        env=EnvCfg(
            scene=SceneCfg(robot=UNITREE_G1_SOLID, terrain=stage2_terrain()),
            sim=physics(),
            episode_length_s=25.0,  # a track of 12 m at the mean speed
            # The benchmark's speed in the middle, and always along the track.
            command=all_directions(speed=(0.2, 0.8), heading_share=1.0),
            observations=Terms(actor=actor_group(), critic=critic_with_cue()),
            rewards=rewards_with_bsga(),
            terminations=falls(),
            events=unaided(),
            observers=Terms(slope_gait=TermCfg(SlopeGait)),  # the cue that the BSGA terms share
            curriculum=Terms(terrain_levels=TermCfg(curricula.TerrainLevels, {"spread": 1.0})),
        ),
        agent=PpoCfg(critic_warmup_iterations=40, entropy_coef=0.001),
        start=WarmStartCfg(
            "HumoSlope-Stage1-Unitree-G1", shipped="experiments/checkpoints/stage1.pt", calibrated="swing_hip"
        ),
    )


@task("HumoSlope-Stage2-NoZMP-Unitree-G1")
def stage2_no_zmp() -> TaskCfg:
    """Ablation: the Stage I that it starts from had no ZMP regulariser."""
    cfg = stage2()
    cfg.start = WarmStartCfg("HumoSlope-Stage1-NoZMP-Unitree-G1", calibrated="swing_hip")
    return cfg


@task("HumoSlope-Stage2-NoCriticCue-Unitree-G1")
def stage2_no_critic_cue() -> TaskCfg:
    """Ablation: the critic does not see the terrain descriptor."""
    cfg = stage2()
    cfg.env.observations.critic = critic_group()
    return cfg


@task("HumoSlope-Stage2-NoRewardPriors-Unitree-G1")
def stage2_no_reward_priors() -> TaskCfg:
    """Ablation: no BSGA rewards."""
    return _without_priors(stage2())


@task("HumoSlope-Stage2-NoBSGA-Unitree-G1")
def stage2_no_bsga() -> TaskCfg:
    """Ablation: neither BSGA rewards nor the terrain descriptor in the critic."""
    return _without_priors(stage2_no_critic_cue())


def _without_priors(cfg: TaskCfg) -> TaskCfg:
    cfg.env.rewards = walking_rewards()
    cfg.env.observers.slope_gait = None
    assert cfg.start is not None
    cfg.start.calibrated = ""
    return cfg
