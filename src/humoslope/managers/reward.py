"""Rewards: a weighted sum of terms, per second."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from rich.table import Table
from torch import Tensor

from humoslope.errors import UserError
from humoslope.managers.terms import StatefulTerms, TermCfg, Terms, bind, first_value

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


@dataclass
class RewardTermCfg(TermCfg):
    """`func(env, **params) -> [N]`; it earns `weight` times its value per second."""

    weight: float = 1.0


class RewardManager:
    """Computes the reward of each step and the mean of each term over finished episodes."""

    def __init__(self, env: Env, cfg: Terms[RewardTermCfg]) -> None:
        self._env = env
        self._stateful = StatefulTerms()
        terms = {name: term for name, term in cfg.items() if term.weight != 0.0}
        self.names = list(terms)
        self._curves = tuple(f"Reward/{name}" for name in terms)
        self._calls = [self._stateful.keep(bind("reward", name, term, env)) for name, term in terms.items()]
        self._weights = torch.tensor([term.weight for term in terms.values()], device=env.device)  # [T]
        self._sums = torch.zeros(env.num_envs, len(terms), device=env.device)  # [N, T] over the episode
        self._seconds = env.zeros()  # [N] they are over
        for name, call in zip(self.names, self._calls, strict=True):
            shape = tuple(first_value("reward", name, call, env).shape)
            if shape != (env.num_envs,):
                raise UserError(
                    f"reward '{name}' returned shape {shape}; it must be ({env.num_envs},), one value per world."
                )
        # Finding the shapes was no step of anyone's episode.
        self._stateful.reset(torch.ones(env.num_envs, dtype=torch.bool, device=env.device))

    def compute(self, dt: float) -> Tensor:
        """The reward [N] of a step of `dt` seconds."""
        if not self._calls:  # an evaluation rewards nothing
            return self._env.zeros()
        values = torch.stack([call(self._env) for call in self._calls], dim=1) * self._weights  # [N, T] per second
        self.last = values
        self._sums = torch.add(self._sums, values, alpha=dt)
        self._seconds += dt
        return values.sum(dim=1) * dt

    def reset(self, mask: Tensor) -> None:
        """Logs and clears the episode sums of the worlds in `mask`, as reward per second."""
        means = self._sums / self._seconds.clamp(min=1e-6)[:, None]
        self._env.log.add_columns(self._curves, means, mask)
        self._sums = self._sums.masked_fill(mask[:, None], 0.0)
        self._seconds = self._seconds.masked_fill(mask, 0.0)
        self._stateful.reset(mask)

    def table(self) -> Table:
        """What is rewarded, and how much."""
        table = Table("reward", "weight per second", title="Rewards")
        for name, weight in zip(self.names, self._weights.tolist(), strict=True):
            table.add_row(name, f"{weight:g}")
        return table
