"""Rewards: a weighted sum of terms, per second."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from rich.table import Table
from torch import Tensor

from humoslope.errors import UserError, unknown
from humoslope.managers.terms import StatefulTerms, TermCfg, Terms, bind, first_value
from humoslope.ranges import Finite, check_config

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


@dataclass
class RewardTermCfg(TermCfg):
    """Reward `func(env, **params) -> [N]`.

    Attributes:
        weight: Reward per second and unit of the term's value; a term of weight 0 is not built.
    """

    weight: Finite = 1.0


class RewardManager:
    """Computes the reward of each step and the mean of each term over finished episodes.

    Attributes:
        names: Names of the terms, in the order of the columns of `last`.
        last: [N, T] weighted value of each term in the last step, per second.
    """

    def __init__(self, env: Env, cfg: Terms[RewardTermCfg]) -> None:
        self._env = env
        self._stateful = StatefulTerms()
        for name, term in cfg.items():
            check_config(f"reward '{name}'", term)
        terms = {name: term for name, term in cfg.items() if term.weight != 0.0}
        self.names = list(terms)
        self._curves = tuple(f"Reward/{name}" for name in terms)
        self._calls = [self._stateful.keep(bind("reward", name, term, env)) for name, term in terms.items()]
        self._weights = torch.tensor([term.weight for term in terms.values()], device=env.device)  # [T]
        self._strength = torch.ones_like(self._weights)  # [T]
        self._sums = env.zeros(len(terms))  # [N, T] over the episode
        self._seconds = env.zeros()  # [N] duration of the sums
        self._watched = env.finite.watch({f"reward '{name}'": 1 for name in terms})
        self.last = env.zeros(len(terms))
        for name, call in zip(self.names, self._calls, strict=True):
            shape = tuple(first_value("reward", name, call, env).shape)
            if shape != (env.num_envs,):
                raise UserError(
                    f"reward '{name}' returned shape {shape}; it must be ({env.num_envs},), one value per env."
                )
        # The calls above, which found the shapes, belong to no episode.
        self._stateful.reset(torch.ones(env.num_envs, dtype=torch.bool, device=env.device))

    def compute(self, dt: float, diverged: Tensor | None = None) -> Tensor:
        """Returns the reward [N] of a step of `dt` seconds.

        Args:
            diverged: [N] bool; envs that earn nothing because their state has no meaning; none by default.
        """
        if not self._calls:  # as in an evaluation
            return self._env.zeros()
        values = torch.stack([call(self._env) for call in self._calls], dim=1)
        values = values * (self._weights * self._strength)  # [N, T] per second
        if diverged is not None:
            values = values.masked_fill(diverged[:, None], 0.0)
        self._watched.add(values, self._env.finite.step)
        self.last = values
        self._sums = torch.add(self._sums, values, alpha=dt)
        self._seconds = self._seconds + dt
        return values.sum(dim=1) * dt

    def set_strength(self, name: str, share: Tensor) -> None:
        """Lets the term called `name` count by a share of its weight (a scalar tensor) from now on; for curricula.

        Raises:
            UserError: If there is no such term.
        """
        if name not in self.names:
            raise unknown("reward", name, self.names)
        self._strength[self.names.index(name)] = share

    def reset(self, mask: Tensor) -> None:
        """Logs and clears the episode sums of the envs in `mask` [N], as reward per second."""
        means = self._sums / self._seconds.clamp(min=1e-6)[:, None]
        self._env.log.add_columns(self._curves, means, mask)
        self._sums = self._sums.masked_fill(mask[:, None], 0.0)
        self._seconds = self._seconds.masked_fill(mask, 0.0)
        self._stateful.reset(mask)

    def table(self) -> Table:
        """Table of the rewards and their weights."""
        table = Table("reward", "weight per second", title="Rewards")
        for name, weight in zip(self.names, self._weights.tolist(), strict=True):
            table.add_row(name, f"{weight:g}")
        return table
