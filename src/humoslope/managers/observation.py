"""Observations: groups of terms with noise, scale and history."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import torch
from rich.table import Table
from tensordict import TensorDict
from torch import Tensor

from humoslope.errors import UserError
from humoslope.managers.terms import StatefulTerms, TermCfg, Terms, bind, first_value
from humoslope.strict import StrictCfg

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env


@dataclass
class ObservationTermCfg(TermCfg):
    """`func(env, **params) -> [N, d]`.

    Attributes:
        noise: Half-width of uniform noise, in the term's own unit, added before the scale.
        scale: Factor on the noisy value.
    """

    noise: float = 0.0
    scale: float = 1.0


def any_noise(env: Env, frame: Tensor) -> Tensor:
    """Numbers in [0, 1) from torch's generator, in the shape of `frame` [N, D]."""
    return torch.rand_like(frame)


@dataclass
class ObservationGroupCfg(StrictCfg):
    """Terms concatenated into one vector.

    Attributes:
        history: Number of control steps it spans; each term's frames stand together, oldest first.
        enable_corruption: Whether noise is added.
        noise_source: `func(env, frame [N, D]) -> [N, D]`, the uniform numbers in [0, 1) that noise is made of.
    """

    terms: Terms[ObservationTermCfg] = field(default_factory=Terms)
    history: int = 1
    enable_corruption: bool = False
    noise_source: Callable[..., Tensor] = any_noise


class ObservationManager:
    """Computes every group as a fresh tensor each step, since the learner keeps references."""

    def __init__(self, env: Env, cfg: Terms[ObservationGroupCfg]) -> None:
        self.groups = {name: _Group(env, name, group) for name, group in cfg.items()}
        self._num_envs = env.num_envs
        self._device = env.device

    def compute(self, restarted: Tensor) -> TensorDict:
        """All groups, [N, d] each. History of the worlds in `restarted` [N] is filled with their first frame."""
        return TensorDict(
            {name: group.compute(restarted) for name, group in self.groups.items()},
            batch_size=[self._num_envs],
            device=self._device,
        )

    def reset(self, mask: Tensor) -> None:
        """Resets the stateful terms."""
        for group in self.groups.values():
            group.stateful.reset(mask)

    def table(self) -> Table:
        """What each group sees."""
        table = Table("group", "term", "size", "scale", "noise", title="Observations")
        for name, group in self.groups.items():
            noisy = " noisy" if group.cfg.enable_corruption else ""
            table.add_row(name, "", f"{group.size}", "", f"history {group.cfg.history}{noisy}", style="bold")
            for term, width in group.widths.items():
                cfg = getattr(group.cfg.terms, term)
                table.add_row(
                    "", term, str(width), f"{cfg.scale:g}", f"±{cfg.noise:g}" if group.cfg.enable_corruption else ""
                )
        return table


class _Group:
    """One frame of all terms is handled as a single [N, D] tensor: one noise draw, one scaling, one history shift."""

    def __init__(self, env: Env, name: str, cfg: ObservationGroupCfg) -> None:
        if cfg.history < 1:
            raise UserError(f"observation group '{name}': history {cfg.history} must be at least 1.")
        self.env, self.cfg = env, cfg
        self.stateful = StatefulTerms()
        self._calls = {n: self.stateful.keep(bind("observation", n, t, env)) for n, t in cfg.terms.items()}
        self.widths: dict[str, int] = {}
        for term, call in self._calls.items():
            shape = tuple(first_value("observation", f"{name}.{term}", call, env).shape)
            if len(shape) != 2 or shape[0] != env.num_envs:
                raise UserError(f"observation '{name}.{term}' returned shape {shape}; it must be ({env.num_envs}, d).")
            self.widths[term] = shape[1]
        frame = sum(self.widths.values())
        self.size = frame * cfg.history
        terms = list(cfg.terms.items())
        self._scale = torch.cat([torch.full((self.widths[n],), t.scale) for n, t in terms]).to(env.device)  # [D]
        noise = torch.cat([torch.full((self.widths[n],), t.noise) for n, t in terms]).to(env.device)
        self._noise = noise * self._scale  # [D]
        self._history = env.zeros(self.size)  # [N, H * D]
        columns = torch.arange(frame, device=env.device).split(list(self.widths.values()))
        self._places = torch.cat([column.repeat(cfg.history) for column in columns])  # [H * D] column of the frame

    def compute(self, restarted: Tensor) -> Tensor:
        frame = torch.cat([call(self.env) for call in self._calls.values()], dim=1)
        frame = frame * self._scale
        if self.cfg.enable_corruption:
            uniform = self.cfg.noise_source(self.env, frame)  # in [0, 1)
            frame = torch.addcmul(frame - self._noise, uniform, 2.0 * self._noise)
        if self.cfg.history == 1:
            return frame
        history = self._shifted(frame)
        if not self.env.sim.known_empty(restarted):
            rows = self.env.sim.known_rows(restarted)
            filled = frame[rows][:, self._places]
            history[rows] = torch.where(restarted[rows, None], filled, history[rows])
        self._history = history
        return history

    def _shifted(self, frame: Tensor) -> Tensor:
        """The history with `frame` [N, D] in place of its oldest frame; each term's frames stand together."""
        widths = list(self.widths.values())
        past = self._history.split([width * self.cfg.history for width in widths], dim=1)
        pairs = zip(past, frame.split(widths, dim=1), strict=True)
        return torch.cat([part for old, new in pairs for part in (old[:, new.shape[1] :], new)], dim=1)
