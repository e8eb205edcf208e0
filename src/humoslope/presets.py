"""Presets of scale: the size at which a task is trained on a kind of machine."""

from __future__ import annotations

from typing import Literal

import torch

from humoslope.errors import unknown
from humoslope.registry import TaskCfg

Preset = Literal["auto", "cpu", "gpu"]


def resolve_preset(preset: Preset) -> Literal["cpu", "gpu"]:
    """Returns the preset itself; for "auto", the one that fits this machine."""
    if preset == "auto":
        return "gpu" if torch.cuda.is_available() else "cpu"
    return preset


def apply_preset(cfg: TaskCfg, preset: Literal["cpu", "gpu"]) -> None:
    """Sets the scale of a task for a machine: number of envs, physics step, width of networks and epochs.

    Rewards are the same in every preset, and so are observations, except for sensors that have a size of their own for
    a preset (`scale_to`).

    Raises:
        UserError: If the preset does not exist.
    """
    if preset == "gpu":
        cfg.env.num_envs = 4096
    elif preset == "cpu":
        cfg.env.num_envs = 512
        # Evaluation stays at 5 ms.
        cfg.env.sim.timestep, cfg.env.sim.decimation = 0.01, 2
        # Faster than the elliptic cone; `make bench ARGS="--env.sim.cone elliptic"` shows by how much. Along the
        # axes of a ramp both hold alike; between them the pyramid holds less, so training is the harder of the two.
        cfg.env.sim.cone = "pyramidal"
    else:
        raise unknown("preset", preset, ("cpu", "gpu"))
    for group in cfg.env.observations.values():
        for term in group.terms.values():
            if hasattr(term.func, "scale_to"):
                term.params.update(term.func.scale_to(preset))
    cfg.agent.scale_to(preset)
