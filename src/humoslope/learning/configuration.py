"""The configuration that a checkpoint was trained with, and in what today's task departs from it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from humoslope.errors import UserError
from humoslope.packing import ROBOT, describe, differences, unpack
from humoslope.presets import apply_preset
from humoslope.provenance import plain
from humoslope.registry import TaskCfg, all_tasks, build_task, content_packages

LISTED = 4
"""Differences that a sentence names."""


def trained_cfg(path: Path, state: Mapping[str, Any]) -> TaskCfg:
    """The configuration in a loaded checkpoint.

    Raises:
        UserError: If it names something that does not exist any more, or a robot whose joints have changed since.
    """
    try:
        cfg: TaskCfg = unpack(state["config"], content_packages())
    except UserError as error:
        raise UserError(f"checkpoint '{path}': {error}") from None
    before = _robot_then(state)["joint_names"]
    if tuple(before) != cfg.env.scene.robot.joint_names:
        raise UserError(
            f"checkpoint '{path}' was trained with other joints of {cfg.env.scene.robot.name} than today's."
        )
    return cfg


def departures(state: Mapping[str, Any], trained: TaskCfg, today: TaskCfg, groups: Iterable[str]) -> str:
    """List, in words, of what the policy sees and moves differently in today's task; "" if nothing.

    Args:
        state: A loaded checkpoint.
        trained: Its configuration.
        today: The task as the code has it.
        groups: Observation groups that the policy reads.
    """
    then, now = _seen(trained, groups), _seen(today, groups)
    found = differences(then, now)
    found += differences(dict(_robot_then(state)), describe(today.env.scene.robot), "robot")
    if not found:
        return ""
    more = f" and {len(found) - LISTED} more" if len(found) > LISTED else ""
    return f"{', '.join(found[:LISTED])}{more}"


def changes_since(path: Path, state: Mapping[str, Any], trained: TaskCfg, groups: Iterable[str]) -> str:
    """A sentence for the reader of a checkpoint whose task has changed since, or ""."""
    task = state["task"]
    if task not in all_tasks():
        return f"Task '{task}' is not registered here; the configuration in '{path}' is used."
    # A sensor may have a size of its own in a preset: that is no change of the task.
    found = min((departures(state, trained, today, groups) for today in _sizes_of(task)), key=len)
    return found and f"Task '{task}' has changed since in {found}; the configuration in '{path}' is used."


def _sizes_of(task: str) -> list[TaskCfg]:
    """The task as it is registered, and in the presets."""
    sizes = [build_task(task) for _ in range(3)]
    apply_preset(sizes[1], "gpu")
    apply_preset(sizes[2], "cpu")
    return sizes


def _seen(cfg: TaskCfg, groups: Iterable[str]) -> dict[str, Any]:
    """Observations, actions and commands of a policy as plain data."""
    env, sim = cfg.env, cfg.env.sim
    observations = {name: plain(group) for name, group in env.observations.items() if name in groups}
    return {
        "observations": observations,
        "actions": plain(env.actions),
        "command": plain(env.command),
        "control_step_s": round(sim.timestep * sim.decimation, 9),
    }


def _robot_then(state: Mapping[str, Any]) -> Mapping[str, Any]:
    """The robot's description in the packed configuration."""
    robot: Mapping[str, Any] = state["config"]["env"]["scene"]["robot"]
    description: Mapping[str, Any] = robot["description"]
    assert ROBOT in robot
    return description
