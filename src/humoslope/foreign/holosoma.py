"""Locomotion networks of holosoma, whose files hold joints, gains and commands; the rest is in holosoma's code."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from humoslope.deploy.contract import GaitClock, Range
from humoslope.errors import UserError
from humoslope.foreign.policy import ForeignPolicy, ForeignTerm, numbers, quantity_of, repeated

KEY = "dof_names"
"""Key by which such a file is recognised."""
OBSERVATIONS = {
    "actions": "last_action",
    "base_ang_vel": "root_angular_velocity",
    "base_lin_vel": "root_linear_velocity",
    "command_ang_vel": "yaw_rate_command",
    "command_lin_vel": "linear_velocity_command",
    "cos_phase": "gait_phase_cosine",
    "dof_pos": "joint_position_offset",
    "dof_vel": "joint_velocity",
    "projected_gravity": "gravity_direction",
    "sin_phase": "gait_phase_sine",
}
"""Quantities by the names of holosoma."""
RANGES = ("lin_vel_x", "lin_vel_y", "ang_vel_yaw")


@dataclass(frozen=True)
class HolosomaRobot:
    """What holosoma keeps in its code for the locomotion of one robot.

    Attributes:
        default: Joint targets of a zero action by the names of the joints, rad; zero for the others.
        scales: Scale of each observation by its name. holosoma feeds them in the order of the alphabet.
        action_scale: Change of every joint target for one unit of action, rad.
        action_bound: Bound on the absolute value of an action.
        gait_clock: Clock of the gait.
        joints: Joints by which its files are recognised.
    """

    default: Mapping[str, float]
    scales: Mapping[str, float]
    action_scale: float
    action_bound: float
    gait_clock: GaitClock
    joints: tuple[str, ...]


def read(metadata: Mapping[str, str], path: Path, robots: list[HolosomaRobot]) -> ForeignPolicy:
    """Returns the policy that metadata describe.

    Args:
        metadata: Texts by their keys, each JSON.
        path: The file, for messages.
        robots: Robots whose conventions are known.

    Raises:
        UserError: If something is missing, or the policy is for none of the robots, or for several.
    """

    def value(key: str) -> Any:
        try:
            return json.loads(metadata[key])
        except (KeyError, ValueError):
            raise UserError(f"'{path}' has metadata of holosoma, but '{key}' is missing or broken.") from None

    joints = tuple(map(str, value(KEY)))
    known = [robot for robot in robots if set(robot.joints) == set(joints)]
    if len(known) != 1:
        which = "that is not known here" if not known else "whose conventions are registered more than once"
        raise UserError(f"'{path}' is of holosoma, for a robot {which}; its first joint is '{joints[0]}'.")
    (robot,) = known
    return ForeignPolicy(
        framework="holosoma",
        joints=joints,
        stiffness=numbers(value("kp"), "kp", path),
        damping=numbers(value("kd"), "kd", path),
        default=tuple(robot.default.get(name, 0.0) for name in joints),
        action_scale=repeated([robot.action_scale], len(joints)),
        terms=tuple(
            ForeignTerm(name, quantity_of(name, OBSERVATIONS, path), (robot.scales[name],))
            for name in sorted(robot.scales)
        ),
        commands=_commands(value("command_ranges"), path),
        action_bound=robot.action_bound,
        gait_clock=robot.gait_clock,
    )


def _commands(ranges: Any, path: Path) -> tuple[Range, Range, Range]:
    try:
        forward, left, turn = (numbers(ranges[name], name, path) for name in RANGES)
        return (forward[0], forward[1]), (left[0], left[1]), (turn[0], turn[1])
    except (TypeError, KeyError, IndexError):
        raise UserError(
            f"'{path}' is of holosoma, but not of its walking: it has no ranges of {', '.join(RANGES)}."
        ) from None
