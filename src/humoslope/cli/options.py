"""Options of verbs that take a task: their own, and every field of the task's configuration."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Generic, Protocol, TypeVar

import docstring_parser
import tyro

from humoslope.cli.overrides import task_rules
from humoslope.env import EnvCfg
from humoslope.errors import UserError
from humoslope.learning.config import AgentCfg
from humoslope.learning.run_folder import saved_options
from humoslope.presets import Preset, apply_preset, resolve_preset
from humoslope.registry import TaskCfg, all_tasks, build_task, load_content


class HasPreset(Protocol):
    """Frozen dataclass of options, among them the scale."""

    @property
    def preset(self) -> Preset:
        """Scale of the training; "auto" for the one that fits the machine."""


A = TypeVar("A", bound=HasPreset)


@dataclasses.dataclass(frozen=True)
class _Command(Generic[A]):
    """All options of a verb that takes a task.

    Attributes:
        env: The environment.
        agent: The learner.
    """

    own: Annotated[A, tyro.conf.arg(name="")]
    env: EnvCfg
    agent: AgentCfg


def named_task(verb: str, arguments: list[str]) -> tuple[str, list[str]] | None:
    """The task that the arguments of a verb begin with, and the options after it; None if help was asked for in its
    place, and printed.

    Raises:
        UserError: If they begin with none.
    """
    load_content()
    if arguments[:1] in (["-h"], ["--help"]):
        print(f"humoslope {verb} TASK [...]; humoslope {verb} TASK --help lists every option.\n")
        print("\n".join(f"  {name}  {line}" for name, line in all_tasks().items()))
        return None
    if not arguments or arguments[0].startswith("-"):
        raise UserError(f"{verb} needs a task: {', '.join(all_tasks())}.")
    return arguments[0], arguments[1:]


def parse(own: A, task: str, options: list[str], verb: str = "train", base: TaskCfg | None = None) -> tuple[TaskCfg, A]:
    """Configuration of a task with preset and overrides applied, and the verb's own options.

    An option that does not exist ends the process with exit code 2 and the nearest match.

    Args:
        own: Options of the verb with their defaults, a dataclass.
        task: Name of the task.
        options: Command line after the task.
        verb: Name of the verb, for the help text.
        base: Configuration that the options change; by default the task's own with the preset.

    Raises:
        UserError: If the task does not exist, or a value is impossible.
    """
    preset = resolve_preset(early(own, task, options, verb).preset)
    cfg = base or build_task(task)
    if base is None:
        apply_preset(cfg, preset)
    kind: Any = _Command
    parsed: _Command[A] = tyro.cli(
        kind[type(own)],
        args=options,
        default=_Command(own, cfg.env, cfg.agent),
        prog=f"humoslope {verb} {task}",
        description=docstring_parser.parse(type(own).__doc__ or "").description,
        config=(tyro.conf.AvoidSubcommands, tyro.conf.SuppressFixed, tyro.conf.HelptextFromCommentsOff),
        registry=task_rules(),
    )
    cfg.env, cfg.agent = parsed.env, parsed.agent
    return cfg, type(own)(**vars(parsed.own) | {"preset": preset})


def early(own: A, task: str, options: list[str], verb: str = "train") -> A:
    """Options of the verb itself, which are needed before those of the task can be listed."""
    quiet = [option for option in options if option not in ("-h", "--help")]
    args, _ = tyro.cli(type(own), args=quiet, prog=f"humoslope {verb} {task}", return_unknown_args=True)
    return args


@dataclasses.dataclass(frozen=True)
class Scale:
    """Options of a verb that has none but the scale."""

    preset: Preset = "auto"


def configuration_of(checkpoint: Path, task: str, options: list[str] | None = None) -> TaskCfg:
    """The configuration behind a checkpoint of the first format, which does not hold it: the task's own, with the
    options of the run if it lies in its run folder."""
    options = saved_options(checkpoint.parent) if options is None else options
    return parse(Scale(), task, options)[0] if options else build_task(task)
