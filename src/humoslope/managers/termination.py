"""When an episode ends, and whether that is a failure."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from rich.table import Table
from torch import Tensor

from humoslope.managers.terms import StatefulTerms, TermCfg, Terms, bind

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


@dataclass
class TerminationTermCfg(TermCfg):
    """`func(env, **params) -> [N] bool`. A `time_out` is no failure:
    the value of what would have followed is bootstrapped."""

    time_out: bool = False


class TerminationManager:
    """Computes which worlds end, and why."""

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
        self._nobody = self.terminated.clone()

    def compute(self) -> Tensor:
        """The worlds [N] (bool) whose episode ends now;
        `terminated` are the failures, `time_outs` the others among them."""
        self._hits = [call(self._env) for call in self._calls]
        self.terminated = self._any(time_out=False)
        self.time_outs = self._any(time_out=True) & ~self.terminated
        return self.terminated | self.time_outs

    def _any(self, time_out: bool) -> Tensor:
        """The worlds [N] that were hit by a term of this sort."""
        hits = [hit for hit, sort in zip(self._hits, self._time_out, strict=True) if sort == time_out]
        return functools.reduce(torch.logical_or, hits, self._nobody)

    def reset(self, mask: Tensor) -> None:
        """Logs why the worlds in `mask` ended, as shares."""
        if self._hits:
            self._env.log.add_columns(self._curves, torch.stack(self._hits, dim=1).to(torch.float32), mask)
        self._stateful.reset(mask)

    def table(self) -> Table:
        """What ends an episode."""
        table = Table("termination", "kind", title="Terminations")
        for name, time_out in zip(self.names, self._time_out, strict=True):
            table.add_row(name, "time-out" if time_out else "failure")
        return table
