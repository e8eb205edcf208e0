"""Selecting joints by name pattern."""

from __future__ import annotations

import re
from functools import lru_cache

import torch
from torch import Tensor

from humoslope.errors import UserError
from humoslope.scene.robot import Robot


@lru_cache(maxsize=256)
def joint_mask(robot: Robot, pattern: str, device: torch.device) -> Tensor:
    """1 for the joints [J] whose whole name matches the regular expression `pattern`, else 0.

    Raises:
        UserError: If it matches none.
    """
    hits = [re.fullmatch(pattern, name) is not None for name in robot.joint_names]
    if not any(hits):
        some = ", ".join(robot.joint_names[:4])
        raise UserError(
            f"joint pattern '{pattern}' matches nothing; {robot.name} has {some}, ... ({robot.num_joints} in all)."
        )
    return torch.tensor(hits, dtype=torch.float32, device=device)
