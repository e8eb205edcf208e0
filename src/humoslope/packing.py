"""Configurations as data that a checkpoint can hold, and back.

Packed are plain values, tuples, lists and dictionaries. A dataclass becomes a dictionary with its class under `TYPE`,
a function or class one with its name under `NAME`, and a robot, whose model is code, one that names it and
describes it under `ROBOT`. Unpacking imports nothing but the packages that hold terms, and calls nothing but the
constructors of configuration dataclasses, so that a checkpoint from elsewhere executes nothing.
"""

from __future__ import annotations

import dataclasses
import hashlib
import sys
from collections.abc import Iterable, Mapping
from functools import reduce
from importlib import import_module
from typing import Any

from humoslope.errors import UserError
from humoslope.managers.terms import Terms
from humoslope.provenance import plain
from humoslope.scene.robot import Robot

TYPE, NAME, ROBOT = "$type", "$name", "$robot"

OWN = ("humoslope.mdp", "humoslope.managers")
"""Modules of this package that functions may come from."""

RENAMED: dict[str, str] = {
    "humoslope.mdp.gallant:joint_vel_l2": "humoslope.mdp.unitree_rl_lab:joint_vel_l2",
    "humoslope.mdp.isaac_lab:AccelerationOfJointsL2": "humoslope.mdp.rewards:JointAccelerationL2",
    "humoslope.mdp.isaac_lab:limits_of_joints": "humoslope.mdp.rewards:joint_pos_limits",
}
"""Names in the configurations of older checkpoints, and today's: an entry for every function or configuration class of
a shipped task that is renamed or moved, such as "humoslope.mdp.rewards:old": "humoslope.mdp.rewards:new"."""


def pack(value: Any) -> Any:
    """A configuration as data.

    Raises:
        UserError: If it holds something that cannot be found again by its name, such as a lambda.
    """
    packed: Any = value
    if isinstance(value, Robot):
        packed = {ROBOT: value.name, "module": value.make_spec.__module__, "description": describe(value)}
    elif isinstance(value, Terms):
        packed = {TYPE: _name(Terms), "terms": {name: pack(term) for name, term in value.items()}}
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: pack(getattr(value, field.name)) for field in dataclasses.fields(value)}
        packed = {TYPE: _name(type(value)), **fields}
    elif isinstance(value, Mapping):
        packed = {key: pack(child) for key, child in value.items()}
    elif isinstance(value, tuple | list):
        packed = type(value)(pack(child) for child in value)
    elif callable(value):
        packed = {NAME: _name(value)}
    elif not (value is None or isinstance(value, bool | int | float | str)):
        raise UserError(f"configuration: {value!r} of type {type(value).__name__} cannot be kept in a checkpoint.")
    return packed


def unpack(value: Any, content: Iterable[str]) -> Any:
    """The configuration that was packed.

    Args:
        content: Packages that hold tasks, robots and terrains, besides this one.

    Raises:
        UserError: If it names something that does not exist any more.
    """
    allowed = (*OWN, *content)
    return _unpack(value, allowed)


def describe(robot: Robot) -> dict[str, Any]:
    """A robot as plain data: its numbers and names, and the hash of its model. Paths and meshes are left out."""
    fields = {k: v for k, v in plain(robot).items() if k not in ("make_spec", "urdf", "meshes")}
    return fields | {"model": hashlib.sha256(robot.make_spec().to_xml().encode()).hexdigest()}


def differences(trained: Any, today: Any, prefix: str = "") -> list[str]:
    """Paths of the values in which two plain configurations differ, such as "env.actions.scale_factor"."""
    if isinstance(trained, Mapping) and isinstance(today, Mapping):
        names = dict.fromkeys([*trained, *today])
        return [
            path
            for name in names
            for path in differences(trained.get(name), today.get(name), f"{prefix}.{name}" if prefix else str(name))
        ]
    return [] if _listed(trained) == _listed(today) else [prefix]


def _listed(value: Any) -> Any:
    return [_listed(v) for v in value] if isinstance(value, tuple | list) else value


def _unpack(value: Any, allowed: tuple[str, ...]) -> Any:
    if isinstance(value, tuple | list):
        return type(value)(_unpack(child, allowed) for child in value)
    if not isinstance(value, Mapping):
        return value
    if ROBOT in value:
        return _find_robot(value, allowed)
    if NAME in value:
        return _find(value[NAME], allowed)
    inner = {key: _unpack(child, allowed) for key, child in value.items() if key != TYPE}
    return _made(value[TYPE], inner, allowed) if TYPE in value else inner


def _made(name: str, inner: dict[str, Any], allowed: tuple[str, ...]) -> Any:
    """A set of terms, or an instance of a configuration class, with these fields."""
    if name == _name(Terms):
        return Terms(**inner["terms"])
    made = _find(name, ("humoslope", *allowed))
    if not (isinstance(made, type) and dataclasses.is_dataclass(made)):
        raise UserError(f"configuration: '{name}' is no configuration class.")
    try:
        return made(**inner)
    except TypeError as error:
        raise UserError(f"configuration: '{name}' has changed since: {error}.") from None


def _find(name: str, allowed: tuple[str, ...]) -> Any:
    """The function or class of a qualified name such as "humoslope.mdp.rewards:alive"."""
    module, _, path = RENAMED.get(name, name).partition(":")
    if not any(module == package or module.startswith(f"{package}.") for package in allowed):
        raise UserError(f"configuration: '{name}' lies outside the packages {', '.join(allowed)}.")
    try:
        return reduce(getattr, path.split("."), import_module(module))
    except (ImportError, AttributeError):
        raise UserError(f"configuration: '{name}' does not exist any more.") from None


def _find_robot(value: Mapping[str, Any], allowed: tuple[str, ...]) -> Robot:
    module, name = value["module"], value[ROBOT]
    if not any(module == package or module.startswith(f"{package}.") for package in allowed):
        raise UserError(f"configuration: robot '{name}' lies outside the packages {', '.join(allowed)}.")
    try:
        found = vars(import_module(module)).values()
    except ImportError:
        raise UserError(f"configuration: '{module}', which had robot '{name}', does not exist any more.") from None
    robots = [thing for thing in found if isinstance(thing, Robot) and thing.name == name]
    if not robots:
        raise UserError(f"configuration: robot '{name}' is not in '{module}' any more.")
    return robots[0]


def _name(thing: Any) -> str:
    module, qualname = thing.__module__, getattr(thing, "__qualname__", "")
    home = sys.modules.get(module)
    try:
        found = reduce(getattr, qualname.split("."), home)
    except AttributeError:
        found = None
    if found is not thing:
        raise UserError(
            f"configuration: {thing!r} cannot be kept in a checkpoint; define it at the top level of a module."
        )
    return f"{module}:{qualname}"
