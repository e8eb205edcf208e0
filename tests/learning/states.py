"""Made-up checkpoints: everything that a checkpoint must hold, from no training."""

from __future__ import annotations

from typing import Any

import torch


def checkpoint_state(**changes: Any) -> dict[str, Any]:
    """The content of a checkpoint of task "Walk" at iteration 4, with these entries instead."""
    state: dict[str, Any] = {
        "task": "Walk",
        "code": "unknown",
        "iteration": 4,
        "total_steps": 64,
        "total_time": 1.5,
        "config": None,
        "policy": {"spec": {}, "weights": {"weight": torch.ones(3)}},
        "learner": {},
        "env": env_state(),
        "rng": {},
        "parent": None,
        "formerly": (),
    }
    return state | changes


def env_state(**curriculum: Any) -> dict[str, Any]:
    """The state of an environment of two worlds, with these terms of the curriculum."""
    return {"level": torch.zeros(2, dtype=torch.int64), "curriculum": curriculum}
