"""Unitree's `deploy.yaml` (unitree_rl_lab) with its `policy.onnx`; the reader of what `deploy.unitree` writes.

Gains are in the order of the motors, everything else in the policy's; `joint_ids_map` gives the motor of each joint of
the policy. Observations stand in the order of the file.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from humoslope.deploy import unitree
from humoslope.deploy.contract import Range
from humoslope.errors import UserError
from humoslope.foreign.policy import UNBOUNDED, ForeignPolicy, ForeignTerm, numbers, quantity_of, repeated, scaled

OBSERVATIONS = {name: quantity for quantity, name in unitree.OBSERVATIONS.items()}
"""Quantities by the names of Unitree's deployment."""
ACTION = "JointPositionAction"
RANGES = ("lin_vel_x", "lin_vel_y", "ang_vel_z")
SWITCHES = ("use_gym_history", "scale_first")
"""Entries beside the observations: all terms of a step stand together; bounds hold after the scale."""
NETWORKS = ("policy.onnx", "exported/policy.onnx", "../exported/policy.onnx")
"""Where the network of a deploy.yaml may lie, from its folder."""


def find_network(path: Path) -> Path:
    """Returns the network that belongs to a deploy.yaml.

    Raises:
        UserError: If there is none.
    """
    for place in NETWORKS:
        if (found := path.parent / place).is_file():
            return found.resolve()
    raise UserError(f"there is no network beside '{path}', at {', '.join(NETWORKS)}; name it with --network.")


def read(path: Path, motors: tuple[str, ...]) -> ForeignPolicy:
    """Returns the policy that a deploy.yaml describes.

    Args:
        path: The file.
        motors: Joints of the robot in the order of its motors.

    Raises:
        UserError: If it is no deploy.yaml, of another robot, or says what a contract cannot.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError):
        raise UserError(f"'{path}' is no readable YAML file.") from None
    try:
        return _read(content, path, motors)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        what = f"lacks {error}" if isinstance(error, KeyError) else "has another form"
        raise UserError(f"'{path}' is not a deploy.yaml of Unitree's: it {what}.") from None


def _read(content: Mapping[str, Any], path: Path, motors: tuple[str, ...]) -> ForeignPolicy:
    ids = [int(i) for i in content["joint_ids_map"]]
    if sorted(ids) != list(range(len(motors))):
        raise UserError(f"'{path}': its joint_ids_map has {len(ids)} motors, and the robot {len(motors)}.")
    joints = tuple(motors[i] for i in ids)
    action = _action(content["actions"], path)
    _check_names(action.get("joint_names") or [], joints, path)
    stiffness, damping = (numbers(content[name], name, path) for name in ("stiffness", "damping"))
    if len(stiffness) != len(motors) or len(damping) != len(motors):
        raise UserError(f"'{path}': its stiffness and damping must have a number for each of {len(motors)} motors.")
    default = numbers(content["default_joint_pos"], "default_joint_pos", path)
    offset = action.get("offset")
    if offset is not None and repeated(numbers(offset, "offset", path), len(joints)) != default:
        raise UserError(f"'{path}': the offset of its actions is not default_joint_pos, which a contract cannot say.")
    observations = dict(content["observations"])
    together, scale_first = (bool(observations.pop(name, False)) for name in SWITCHES)
    return ForeignPolicy(
        framework="Unitree's deploy.yaml",
        joints=joints,
        stiffness=tuple(stiffness[i] for i in ids),
        damping=tuple(damping[i] for i in ids),
        default=default,
        action_scale=repeated(numbers(action["scale"], "scale", path), len(joints)),
        terms=tuple(_term(name, entry, scale_first, path) for name, entry in observations.items()),
        frames_together=together,
        commands=_commands(content.get("commands") or {}, path),
        control_step_s=numbers([content["step_dt"]], "step_dt", path)[0],
    )


def _action(actions: Mapping[str, Any], path: Path) -> Mapping[str, Any]:
    if list(actions) != [ACTION]:
        raise UserError(f"'{path}': its actions are {', '.join(actions) or 'none'}; only {ACTION} can be taken.")
    action: Mapping[str, Any] = actions[ACTION]
    for name in ("clip", "joint_ids"):
        if action.get(name) is not None:
            raise UserError(f"'{path}': its actions have '{name}', which a contract cannot say.")
    return action


def _check_names(patterns: list[str], joints: tuple[str, ...], path: Path) -> None:
    """Raises UserError if the names in a file, which may be patterns, are not those that its map of motors gives."""
    literal = [name for name in patterns if re.fullmatch(r"\w+", name)]
    for name in literal:
        if name not in joints:
            raise UserError(f"'{path}': the robot has no joint '{name}'.")
    if len(literal) == len(joints) and tuple(literal) != joints:
        wrong = next(i for i, name in enumerate(literal) if name != joints[i])
        raise UserError(
            f"'{path}': joint {wrong} of its actions is '{literal[wrong]}', but by joint_ids_map '{joints[wrong]}'."
        )


def _term(name: str, entry: Mapping[str, Any], scale_first: bool, path: Path) -> ForeignTerm:
    plain = ForeignTerm(name, quantity_of(name, OBSERVATIONS, path), history=int(entry.get("history_length") or 1))
    given = entry.get("scale")
    scale = (1.0,) if given is None else numbers(given if isinstance(given, list) else [given], "scale", path)
    clip: Range = UNBOUNDED
    if entry.get("clip") is not None:
        low, high = numbers(entry["clip"], "clip", path, finite=False)
        clip = (low, high)
    if scale_first:
        return ForeignTerm(name, plain.quantity, scale, (clip,), plain.history)
    return scaled(plain, scale, clip)


def _commands(commands: Mapping[str, Any], path: Path) -> tuple[Range, Range, Range] | None:
    ranges = (commands.get(unitree.COMMAND) or {}).get("ranges")
    if ranges is None:
        return None
    forward, left, turn = (numbers(ranges[name], name, path) for name in RANGES)
    return (forward[0], forward[1]), (left[0], left[1]), (turn[0], turn[1])
