"""Observers: what measures or records an episode without changing it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rich.table import Table
from torch import Tensor

from humoslope.errors import unknown
from humoslope.managers.terms import StatefulTerms, TermCfg, Terms, bind

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

Observer = Callable[["Env"], object]


class ObserverManager:
    """Calls every observer in each control step, after the rewards and before anything changes the episode.

    Observers of the configuration, `func(env, **params)`, are found by name, so that several terms can share what one
    of them measures. Others are appended and removed while the environment runs, such as recorders.
    """

    def __init__(self, env: Env, cfg: Terms[TermCfg]) -> None:
        self._env = env
        self._stateful = StatefulTerms()
        self._named = {n: self._stateful.keep(bind("observer", n, term, env)) for n, term in cfg.items()}
        self._added: list[Observer] = []

    def __getitem__(self, name: str) -> Any:
        """Returns the configured observer called `name`.

        Raises:
            UserError: If there is none.
        """
        if name not in self._named:
            raise unknown("observer", name, self._named)
        return self._named[name]

    def __len__(self) -> int:
        return len(self._named) + len(self._added)

    def append(self, observer: Observer) -> None:
        """Adds an observer that is called from the next step on."""
        self._added.append(observer)

    def remove(self, observer: Observer) -> None:
        """Removes an observer that was appended."""
        self._added.remove(observer)

    def step(self) -> None:
        """Calls every observer."""
        for observe in (*self._named.values(), *self._added):
            observe(self._env)

    def reset(self, mask: Tensor) -> None:
        """Resets the stateful observers of the configuration in the envs in `mask` [N]."""
        self._stateful.reset(mask)

    def table(self) -> Table:
        """Table of the configured observers."""
        table = Table("observer", title="Observers")
        for name in self._named:
            table.add_row(name)
        return table
