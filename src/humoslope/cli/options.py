"""Options of verbs that take a task: their own, and every field of the task's configuration."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, Protocol, TypeVar

import tyro

from humoslope.cli.overrides import mirror_type, option_names, write_back
from humoslope.errors import UserError, unknown
from humoslope.learning.run_folder import saved_options
from humoslope.presets import Preset, apply_preset, resolve_preset
from humoslope.registry import TaskCfg, build_task


class HasPreset(Protocol):
    """A frozen dataclass of options, among them the scale."""

    @property
    def preset(self) -> Preset:
        """Scale: "cpu", "gpu", or "auto" for what the machine has."""


A = TypeVar("A", bound=HasPreset)


def parse(own: A, task: str, options: list[str], verb: str = "train", base: TaskCfg | None = None) -> tuple[TaskCfg, A]:
    """The task's configuration with preset and overrides applied, and the verb's own options.

    Args:
        own: The verb's options with their defaults, a dataclass.
        task: Name of the task.
        options: As typed.
        base: A configuration to apply the options to, as it is; by default the task's own with the preset.

    Raises:
        UserError: If the task or an option does not exist.
    """
    preset = resolve_preset(early(own, task, options, verb).preset)
    cfg = base or build_task(task)
    if base is None:
        apply_preset(cfg, preset)
    mirrored = mirror_type("Options", {**vars(own), "env": cfg.env, "agent": cfg.agent})
    assert mirrored is not None
    kind, default = mirrored
    found: Any = tyro.cli(
        kind,
        args=options,
        default=default,
        prog=f"humoslope {verb} {task}",
        description=type(own).__doc__ or "",
        return_unknown_args=True,
    )
    parsed, strange = found
    if strange and strange[0].startswith("-"):
        raise unknown("option", strange[0].partition("=")[0], option_names(default))
    if strange:
        raise UserError(f"'{strange[0]}' follows no option; options look like --env.num-envs 64.")
    write_back(cfg.env, parsed.env)
    write_back(cfg.agent, parsed.agent)
    names = [f.name for f in dataclasses.fields(own)]  # type: ignore[arg-type]
    values = {name: getattr(parsed, name) for name in names} | {"preset": preset}
    return cfg, type(own)(**values)


def early(own: A, task: str, options: list[str], verb: str = "train") -> A:
    """The verb's own options, which have to be known before the task's can be read."""
    quiet = [option for option in options if option not in ("-h", "--help")]
    args, _ = tyro.cli(type(own), args=quiet, prog=f"humoslope {verb} {task}", return_unknown_args=True)
    return args


@dataclasses.dataclass(frozen=True)
class Scale:
    """The scale alone, for who reads the options that a run was started with."""

    preset: Preset = "auto"


def trained_task(checkpoint: Path, task: str) -> TaskCfg:
    """The configuration behind a checkpoint of the first format, which does not hold it: the task's own, with the
    options of the run if it lies in its run folder."""
    options = saved_options(checkpoint.parent)
    return parse(Scale(), task, options)[0] if options else build_task(task)
