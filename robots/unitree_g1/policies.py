"""Policies that others have published for the Unitree G1, and what their frameworks keep in their code."""

from __future__ import annotations

import math

from humoslope.deploy.contract import GaitClock
from humoslope.downloads import Wheel
from humoslope.foreign.holosoma import HolosomaRobot
from humoslope.foreign.published import PublishedPolicy
from humoslope.scene.sensors import SIDES
from robots.unitree_g1.model import DRIVES

# holosoma-inference 0.1.3, config_values: robot.py, observation.py, task.py; policies/locomotion.py for the clock.
HOLOSOMA_G1 = HolosomaRobot(
    joints=tuple(DRIVES),
    default={
        **{f"{side}_hip_pitch_joint": -0.312 for side in SIDES},
        **{f"{side}_knee_joint": 0.669 for side in SIDES},
        **{f"{side}_ankle_pitch_joint": -0.363 for side in SIDES},
        **{f"{side}_shoulder_pitch_joint": 0.2 for side in SIDES},
        "left_shoulder_roll_joint": 0.2,
        "right_shoulder_roll_joint": -0.2,
        **{f"{side}_elbow_joint": 0.6 for side in SIDES},
    },
    scales={
        "base_ang_vel": 0.25,
        "projected_gravity": 1.0,
        "command_lin_vel": 1.0,
        "command_ang_vel": 1.0,
        "dof_pos": 1.0,
        "dof_vel": 0.05,
        "actions": 1.0,
        "sin_phase": 1.0,
        "cos_phase": 1.0,
    },
    action_scale=0.25,
    action_bound=100.0,
    gait_clock=GaitClock(period_s=1.0, offsets_rad=(0.0, math.pi), rest_below=0.01),
)

HOLOSOMA = Wheel(
    package="holosoma-inference",
    version="0.1.3",
    sha256="3c11fd4595bc82921d4c44f77357667828761548c1ce74782ea77937b2ab0ef7",
    carries="the policies",
)
LICENCE = (
    "The policy is Amazon FAR's, of holosoma (https://github.com/amazon-far/holosoma), whose repository is under the "
    "Apache License 2.0; the package itself has no licence file."
)
ABOUT = "It was trained on ground without slopes."

HOLOSOMA_PPO, HOLOSOMA_FASTSAC = (
    PublishedPolicy(
        f"holosoma-{learner}",
        HOLOSOMA,
        f"holosoma_inference/models/loco/g1_29dof/{learner}_g1_29dof.onnx",
        ABOUT,
        LICENCE,
    )
    for learner in ("ppo", "fastsac")
)
