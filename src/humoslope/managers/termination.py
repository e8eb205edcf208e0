"""Terminations: the ends of episodes, as failures or as time-outs."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from rich.table import Table
from torch import Tensor

from humoslope.errors import UserError, unknown
from humoslope.managers.terms import StatefulTerms, TermCfg, Terms, bind

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


@dataclass
class TerminationTermCfg(TermCfg):
    """Termination `func(env, **params) -> [N]` (bool).

    Attributes:
        time_out: Cut the episode short instead of failing it, so that a learner bootstraps the value of its
            last state.
    """

    time_out: bool = False


class TerminationManager:
    """Computes which episodes end, and why.

    Attributes:
        terminated: [N] bool; episodes that failed in the last step.
        time_outs: [N] bool; episodes that ended in the last step without failing.
    """

    def __init__(self, env: Env, cfg: Terms[TerminationTermCfg]) -> None:
        self._env = env
        self._stateful = StatefulTerms()
        self._time_out = [term.time_out for _, term in cfg.items()]
        self.names = [name for name, _ in cfg.items()]
        self._curves = tuple(f"Termination/{name}" for name in self.names)
        self._calls = [self._stateful.keep(bind("termination", name, term, env)) for name, term in cfg.items()]
        self.terminated = torch.zeros(env.num_envs, dtype=torch.bool, device=env.device)
        self.time_outs = self.terminated.clone()
        self._hits = [self.terminated.clone() for _ in self.names]
        self._nowhere = self.terminated.clone()

    def compute(self) -> Tensor:
        """Returns the envs [N] (bool) whose episode ends now, and sets `terminated` and `time_outs`."""
        self._hits = [self._checked(name, call(self._env)) for name, call in zip(self.names, self._calls, strict=True)]
        self.terminated = self._any(time_out=False)
        self.time_outs = self._any(time_out=True) & ~self.terminated
        return self.terminated | self.time_outs

    def __getitem__(self, name: str) -> Tensor:
        """Returns the envs [N] (bool) in which the term called `name` held in the last step.

        Raises:
            UserError: If there is none.
        """
        if name not in self.names:
            raise unknown("termination", name, self.names)
        return self._hits[self.names.index(name)]

    def _checked(self, name: str, hit: Tensor) -> Tensor:
        """The value of a term, which `logical_or` would take in other shapes and types too, and make something of."""
        if hit.shape != self._nowhere.shape or hit.dtype != torch.bool:
            raise UserError(
                f"termination '{name}' returned {hit.dtype} of shape {tuple(hit.shape)}; it must be bool of shape "
                f"({self._env.num_envs},), one value per env."
            )
        return hit

    def _any(self, time_out: bool) -> Tensor:
        """The envs [N] in which a term of this sort holds."""
        hits = [hit for hit, sort in zip(self._hits, self._time_out, strict=True) if sort == time_out]
        return functools.reduce(torch.logical_or, hits, self._nowhere)

    def reset(self, mask: Tensor, counted: Tensor | None = None) -> None:
        """Logs the shares of the reasons for which the episodes in `mask` [N] ended, and resets the stateful terms.

        Args:
            counted: [N] bool; the episodes whose reason is logged, all in `mask` by default.
        """
        if self._hits:
            hits = torch.stack(self._hits, dim=1).to(torch.float32)
            self._env.log.add_columns(self._curves, hits, mask if counted is None else mask & counted)
        self._stateful.reset(mask)

    def table(self) -> Table:
        """Table of the terminations and their kind."""
        table = Table("termination", "kind", title="Terminations")
        for name, time_out in zip(self.names, self._time_out, strict=True):
            table.add_row(name, "time-out" if time_out else "failure")
        return table
