"""Selection of joints and bodies by name, and the declarations that check such names when a term is built."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any

import torch
from torch import Tensor

from humoslope.errors import UserError, unknown
from humoslope.scene.robot import Robot
from humoslope.scene.sensors import SIDES

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


@lru_cache(maxsize=256)
def joint_mask(robot: Robot, pattern: str, device: torch.device) -> Tensor:
    """1 for the joints [J] whose whole name matches the regular expression `pattern`, else 0.

    Raises:
        UserError: If it matches none.
    """
    hits = _hits(robot, pattern)
    if not any(hits):
        some = ", ".join(robot.joint_names[:4])
        raise UserError(
            f"joint pattern '{pattern}' matches nothing; {robot.name} has {some}, ... ({robot.num_joints} in all)."
        )
    return torch.tensor(hits, dtype=torch.float32, device=device)


@lru_cache(maxsize=256)
def joint_pair(robot: Robot, pattern: str, device: torch.device) -> Tensor:
    """Index [2] of the left and of the right joint that match the regular expression `pattern`, such as
    ".*_knee_joint", for `index_select`: a list of numbers would be copied to the device at each use.

    Raises:
        UserError: If `pattern` does not match exactly one whole name with "left" in it and one with "right".
    """
    hits = [i for i, hit in enumerate(_hits(robot, pattern)) if hit]
    left, right = ([i for i in hits if side in robot.joint_names[i]] for side in SIDES)
    if len(hits) != 2 or len(left) != 1 or len(right) != 1:
        found = ", ".join(robot.joint_names[i] for i in hits) or "nothing"
        raise UserError(
            f"joint pattern '{pattern}' must match one left and one right joint of {robot.name}; it matches {found}."
        )
    return torch.tensor([left[0], right[0]], device=device)


def body_id(env: Env, name: str) -> int:
    """Id of a body of the model.

    Raises:
        UserError: If the model has no body of this name.
    """
    found = env.body_id(name)
    if found < 0:
        model = env.sim.model
        raise unknown("body", name, [model.body(i).name for i in range(1, model.nbody)])
    return found


@dataclass(frozen=True)
class Found:
    """Declaration of a name that `find(env, name)` must be able to resolve (see `humoslope.ranges`)."""

    find: Callable[[Any, str], object]

    def fault(self, value: Any, env: Any) -> str | None:
        """See `humoslope.ranges.Declaration.fault`."""
        if not isinstance(value, str):
            return "it must be a name"
        try:
            if env is not None:
                self.find(env, value)
        except UserError as error:
            return str(error).removesuffix(".")
        return None


Joints = Annotated[str, Found(lambda env, name: joint_mask(env.robot, name, env.device))]
"""Regular expression on whole joint names that matches at least one."""
JointPair = Annotated[str, Found(lambda env, name: joint_pair(env.robot, name, env.device))]
"""Regular expression on whole joint names that matches one left and one right joint."""
Body = Annotated[str, Found(body_id)]
"""Name of a body of the model."""


def _hits(robot: Robot, pattern: str) -> list[bool]:
    try:
        expression = re.compile(pattern)
    except re.error as error:
        raise UserError(f"joint pattern '{pattern}' is not a regular expression: {error}.") from None
    return [expression.fullmatch(name) is not None for name in robot.joint_names]
