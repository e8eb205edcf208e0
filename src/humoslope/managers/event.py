"""Events: changes to the envs from outside (randomisation, resets, pushes, the training harness)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import torch
from rich.table import Table
from torch import Tensor

from humoslope.errors import UserError, unknown
from humoslope.managers.clock import check_interval
from humoslope.managers.terms import StatefulTerms, TermCfg, Terms, bind
from humoslope.ranges import PositiveSpan

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

Mode = Literal["startup", "reset", "interval", "step"]
MODES: tuple[Mode, ...] = ("startup", "reset", "interval", "step")


@dataclass
class EventTermCfg(TermCfg):
    """Event `func(env, mask, **params)`, acting on the envs in `mask` [N].

    A reset event writes rows of `env.start_qpos` and `env.start_qvel`, which hold the default start when it is called.

    Attributes:
        mode: "startup": once, at construction. "reset": whenever an episode starts. "interval": once per drawn
            interval. "step": in every control step.
        interval_s: Shortest and longest time between two firings of an interval event, s.
    """

    mode: Mode = "reset"
    interval_s: PositiveSpan | None = None


class EventManager:
    """Runs the events of each mode."""

    def __init__(self, env: Env, cfg: Terms[EventTermCfg]) -> None:
        self._env = env
        self._stateful = StatefulTerms()
        self._calls: dict[Mode, dict[str, Callable[..., Any]]] = {mode: {} for mode in MODES}
        self._intervals: dict[str, tuple[float, float]] = {}  # name -> shortest and longest, control steps
        self._steps_left: dict[str, Tensor] = {}  # name -> [N] whole numbers
        self._everywhere = torch.ones(env.num_envs, dtype=torch.bool, device=env.device)
        for name, term in cfg.items():
            if term.mode not in MODES:
                raise UserError(f"event '{name}': mode '{term.mode}' does not exist; there are {', '.join(MODES)}.")
            self._calls[term.mode][name] = self._stateful.keep(bind("event", name, term, env, ("env", "mask")))
            if term.mode == "interval":
                self._intervals[name] = check_interval(f"event '{name}': interval_s", term.interval_s, env.step_dt)
                self._steps_left[name] = self._draw(name)

    def __getitem__(self, name: str) -> Any:
        """Returns the event called `name`.

        Raises:
            UserError: If there is none.
        """
        calls = {n: call for mode in self._calls.values() for n, call in mode.items()}
        if name not in calls:
            raise unknown("event", name, calls)
        return calls[name]

    def startup(self) -> None:
        """Runs the startup events on every env."""
        self._run("startup", self._everywhere)

    def reset(self, mask: Tensor) -> None:
        """Runs the reset events on the envs in `mask` [N], then resets the stateful events of every mode."""
        self._run("reset", mask)
        self._stateful.reset(mask)

    def step(self) -> None:
        """Runs the step events, and the interval events of the envs in which they are due."""
        self._run("step", self._everywhere)
        for name, call in self._calls["interval"].items():
            left = self._steps_left[name] - 1.0
            due = left <= 0.0
            if self._env.sim.known_empty(due):
                self._steps_left[name] = left
                continue
            self._steps_left[name] = torch.where(due, self._draw(name), left)
            call(self._env, due)

    def _run(self, mode: Mode, mask: Tensor) -> None:
        for call in self._calls[mode].values():
            call(self._env, mask)

    def _draw(self, name: str) -> Tensor:
        """Control steps until the next firing, [N] whole numbers."""
        low, high = self._intervals[name]
        return torch.empty(self._env.num_envs, device=self._env.device).uniform_(low, high).round_().clamp_(min=1.0)

    def table(self) -> Table:
        """Table of the events and when they run."""
        table, dt = Table("event", "when", title="Events"), self._env.step_dt
        for mode in MODES:
            for name in self._calls[mode]:
                low, high = self._intervals.get(name, (0.0, 0.0))
                table.add_row(name, f"every {low * dt:g} to {high * dt:g} s" if name in self._intervals else mode)
        return table
