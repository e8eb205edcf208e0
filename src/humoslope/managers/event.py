"""Events: what changes the worlds from outside (randomisation, resets, pushes, the training harness)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import torch
from rich.table import Table
from torch import Tensor

from humoslope.errors import UserError, unknown
from humoslope.managers.terms import StatefulTerms, TermCfg, Terms, bind

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

Mode = Literal["startup", "reset", "interval", "step"]
MODES: tuple[Mode, ...] = ("startup", "reset", "interval", "step")


@dataclass
class EventTermCfg(TermCfg):
    """`func(env, mask, **params)`, acting on the worlds in `mask` [N].

    Attributes:
        mode: At construction, at each reset, every so often, or at each step.
        interval_s: Shortest and longest time between two strokes of an interval event, s.
    """

    mode: Mode = "reset"
    interval_s: tuple[float, float] | None = None


class EventManager:
    """Runs the events of each mode."""

    def __init__(self, env: Env, cfg: Terms[EventTermCfg]) -> None:
        self._env = env
        self._stateful = StatefulTerms()
        self._calls: dict[Mode, dict[str, Callable[..., Any]]] = {mode: {} for mode in MODES}
        self._intervals: dict[str, tuple[float, float]] = {}
        self._time_left: dict[str, Tensor] = {}  # name -> [N] s
        for name, term in cfg.items():
            if term.mode not in MODES:
                raise UserError(f"event '{name}': mode '{term.mode}' does not exist; there are {', '.join(MODES)}.")
            self._calls[term.mode][name] = self._stateful.keep(bind("event", name, term, env, ("env", "mask")))
            if term.mode == "interval":
                low, high = term.interval_s or (0.0, 0.0)
                if not 0.0 < low <= high:
                    raise UserError(
                        f"event '{name}': interval_s {term.interval_s} must be two positive times, shortest first."
                    )
                self._intervals[name] = (low, high)
                self._time_left[name] = self._draw(name)

    def __getitem__(self, name: str) -> Any:
        """The event called `name`.

        Raises:
            UserError: If there is none.
        """
        calls = {n: call for mode in self._calls.values() for n, call in mode.items()}
        if name not in calls:
            raise unknown("event", name, calls)
        return calls[name]

    def startup(self) -> None:
        """Runs the startup events on every world."""
        self._run("startup", torch.ones(self._env.num_envs, dtype=torch.bool, device=self._env.device))

    def reset(self, mask: Tensor) -> None:
        """Runs the reset events on the worlds in `mask`."""
        self._run("reset", mask)
        self._stateful.reset(mask)

    def step(self, dt: float) -> None:
        """Runs the step events, and the interval events of the worlds whose time has come."""
        self._run("step", torch.ones(self._env.num_envs, dtype=torch.bool, device=self._env.device))
        for name, call in self._calls["interval"].items():
            left = self._time_left[name] - dt
            due = left <= 0.0
            if self._env.sim.known_empty(due):
                self._time_left[name] = left
                continue
            self._time_left[name] = torch.where(due, self._draw(name), left)
            call(self._env, due)

    def _run(self, mode: Mode, mask: Tensor) -> None:
        for call in self._calls[mode].values():
            call(self._env, mask)

    def _draw(self, name: str) -> Tensor:
        low, high = self._intervals[name]
        return torch.empty(self._env.num_envs, device=self._env.device).uniform_(low, high)

    def table(self) -> Table:
        """What happens to the worlds, and when."""
        table = Table("event", "when", title="Events")
        for mode in MODES:
            for name in self._calls[mode]:
                when = "every {:g} to {:g} s".format(*self._intervals[name]) if name in self._intervals else mode
                table.add_row(name, when)
        return table
