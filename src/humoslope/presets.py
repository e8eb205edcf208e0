"""Scale presets: how large a task is trained on which machine."""

from __future__ import annotations

from typing import Literal

import torch

from humoslope.errors import unknown
from humoslope.registry import TaskCfg

Preset = Literal["auto", "cpu", "gpu"]


def resolve_preset(preset: Preset) -> Literal["cpu", "gpu"]:
    """The preset itself; for "auto", the one for what this machine has."""
    if preset == "auto":
        return "gpu" if torch.cuda.is_available() else "cpu"
    return preset


def apply_preset(cfg: TaskCfg, preset: Literal["cpu", "gpu"]) -> None:
    """Sets the scale of a task for a machine: worlds, network width, epochs and physics step;
    never what is observed or rewarded.

    Raises:
        UserError: If the preset does not exist.
    """
    if preset == "gpu":
        cfg.env.num_envs = 4096
    elif preset == "cpu":
        cfg.env.num_envs = 512
        # Evaluation stays at 5 ms.
        cfg.env.sim.timestep, cfg.env.sim.decimation = 0.01, 2
        # Faster than the elliptic cone; `make bench ARGS="--env.sim.cone elliptic"` tells by how much. Along a ramp's
        # axes both hold alike; between them the pyramid holds less, so that training is the harder of the two.
        cfg.env.sim.cone = "pyramidal"
    else:
        raise unknown("preset", preset, ("cpu", "gpu"))
    cfg.agent.scale_to(preset)
