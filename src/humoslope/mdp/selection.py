"""Selecting joints by name pattern."""

from __future__ import annotations

import re
from functools import lru_cache

import torch
from torch import Tensor

from humoslope.errors import UserError
from humoslope.scene.robot import Robot
from humoslope.scene.sensors import SIDES


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


@lru_cache(maxsize=256)
def joint_pair(robot: Robot, pattern: str) -> tuple[int, int]:
    """Index of the left and of the right joint that the regular expression `pattern` names, such as ".*_knee_joint".

    Raises:
        UserError: If whole names do not give exactly one joint of each side, told by "left" and "right" in them.
    """
    hits = [i for i, name in enumerate(robot.joint_names) if re.fullmatch(pattern, name)]
    left, right = ([i for i in hits if side in robot.joint_names[i]] for side in SIDES)
    if len(hits) != 2 or len(left) != 1 or len(right) != 1:
        found = ", ".join(robot.joint_names[i] for i in hits) or "nothing"
        raise UserError(
            f"joint pattern '{pattern}' must match one left and one right joint of {robot.name}; it matches {found}."
        )
    return left[0], right[0]
