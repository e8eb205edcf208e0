"""What touches the ground tells a robot that kneels from one that has fallen."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch

from humoslope.env import EnvCfg, ManagerBasedRlEnv
from humoslope.terrain import TerrainGridCfg


def on_the_flat(cfg: EnvCfg) -> None:
    cfg.scene.terrain = TerrainGridCfg(columns={"flat": 1.0}, levels=1, num_columns=1)
    cfg.command.modes = {}


@pytest.fixture(scope="module")
def env(make_stage1: Callable[..., ManagerBasedRlEnv]) -> ManagerBasedRlEnv:
    return make_stage1(1, on_the_flat)


def put(env: ManagerBasedRlEnv, height: float, pitch: float, **joints: float) -> None:
    """Places the root at a height over the ground, leaning forward by `pitch`, with these joints of both legs bent."""
    qpos = env._default_qpos[None].clone()
    qpos[0, :3] = env.tiles.origin_w[0] + torch.tensor([3.0, 0.0, height])
    qpos[0, 3:7] = torch.tensor([math.cos(0.5 * pitch), 0.0, math.sin(0.5 * pitch), 0.0])
    for name, angle in joints.items():
        for side in ("left", "right"):
            qpos[0, 7 + env.robot.joint_names.index(f"{side}_{name}_joint")] = angle
    env.sim.reset(torch.tensor([True]), qpos, torch.zeros_like(env.sim.state("qvel"), dtype=torch.float32))
    env.signals.refresh()


def test_standing_touches_with_the_feet_alone(env: ManagerBasedRlEnv) -> None:
    put(env, env.robot.default_root_height - 0.005, 0.0)
    assert env.signals.foot_contact.all()
    assert env.signals.body_force < 1e-3
    assert env.signals.upper_force < 1e-3


def test_kneeling_touches_with_the_shins_too_but_with_nothing_above(env: ManagerBasedRlEnv) -> None:
    heights = torch.linspace(0.5, 0.3, 41).tolist()
    for height in heights:  # down until something touches
        put(env, height, 0.5 * math.pi, hip_pitch=-0.5 * math.pi, knee=0.5 * math.pi, ankle_pitch=0.4)
        if env.signals.body_force > 1.0:
            break
    assert env.signals.body_force > 1.0
    assert env.signals.upper_force < 1e-2


def test_lying_touches_with_what_must_not_touch(env: ManagerBasedRlEnv) -> None:
    put(env, 0.1, 0.5 * math.pi, hip_pitch=0.0, knee=0.0)
    assert env.signals.upper_force > 10.0
