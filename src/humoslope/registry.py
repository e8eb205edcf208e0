"""Registry of tasks. A task is a function that builds its whole configuration each time it is called."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Protocol, TypeVar

from humoslope import shipped
from humoslope.errors import UserError, unknown
from humoslope.strict import StrictCfg

if TYPE_CHECKING:
    from humoslope.env import EnvCfg
    from humoslope.learning.config import AgentCfg


@dataclass
class WarmStartCfg(StrictCfg):
    """Earlier task whose actor, and whose swing calibration, a task starts with.

    Attributes:
        task: Name of the earlier task.
        shipped: Path of a checkpoint of that task that comes with HumoSlope, used if the user has trained none; "" for
            none.
        calibrated: Name of the reward that the swing calibration of the earlier checkpoint sets; "" for none.
    """

    task: str
    shipped: str = ""
    calibrated: str = ""


@dataclass
class TaskCfg(StrictCfg):
    """Whole configuration of a task.

    Attributes:
        env: The environment.
        agent: The learner.
        start: Earlier task that a run starts from; None to start from nothing.
    """

    env: EnvCfg
    agent: AgentCfg
    start: WarmStartCfg | None = None


class Named(Protocol):
    """Whatever has a name."""

    @property
    def name(self) -> str:
        """The name."""


T = TypeVar("T")
N = TypeVar("N", bound=Named)
TaskFunction = Callable[[], TaskCfg]

_tasks: dict[str, TaskFunction] = {}


def task(name: str) -> Callable[[TaskFunction], TaskFunction]:
    """Registers the decorated function under `name`; `humoslope list` prints the first line of its docstring.

    Raises:
        UserError: If the name is taken.
    """

    def register(func: TaskFunction) -> TaskFunction:
        if name in _tasks and _tasks[name].__module__ != func.__module__:
            raise UserError(f"task '{name}' is registered twice, in {_tasks[name].__module__} and {func.__module__}.")
        _tasks[name] = func
        return func

    return register


def build_task(name: str) -> TaskCfg:
    """Returns a new configuration of the task `name`.

    Raises:
        UserError: If it does not exist.
    """
    if name not in _tasks:
        raise unknown("task", name, _tasks)
    return _tasks[name]()


def all_tasks() -> dict[str, str]:
    """Returns the names of the registered tasks, each with a line of description."""
    return {name: (func.__doc__ or "").strip().split("\n")[0] for name, func in sorted(_tasks.items())}


def content_packages() -> tuple[str, ...]:
    """Returns the packages that hold registered tasks and the content that they use."""
    homes = (func.__module__.partition(".")[0] for func in _tasks.values())
    return tuple(dict.fromkeys(["tasks", "robots", "terrains", *homes]))


def content_of(kind: type[T]) -> list[T]:
    """Returns the instances of a class, such as `Robot`, at the top level of the loaded modules of content."""
    homes = content_packages()
    modules = [module for name, module in sorted(sys.modules.items()) if name.partition(".")[0] in homes]
    found = [thing for module in modules for thing in vars(module).values() if isinstance(thing, kind)]
    return list({id(thing): thing for thing in found}.values())


def content_named(kind: type[N], name: str, what: str) -> N:
    """Returns the one of `content_of` that has this name.

    Raises:
        UserError: If there is none; `what` says what it would be.
    """
    named = {thing.name: thing for thing in content_of(kind)}
    if name not in named:
        raise unknown(what, name, named)
    return named[name]


def load_content() -> None:
    """Imports the robots, terrains and tasks that come with HumoSlope, those in the working folder, and installed
    packages that have entry points `humoslope.tasks`."""
    shipped.load()
    for entry in entry_points(group="humoslope.tasks"):
        entry.load()
