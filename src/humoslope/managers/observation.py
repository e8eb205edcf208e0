"""Observations: groups of terms with noise, scale and history."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

import torch
from rich.table import Table
from torch import Tensor

from humoslope.errors import UserError
from humoslope.managers.terms import StatefulTerm, StatefulTerms, TermCfg, Terms, bind, first_value
from humoslope.memory import require_memory
from humoslope.ranges import Finite, NotNegative, Range, check_config
from humoslope.strict import StrictCfg

if TYPE_CHECKING:
    from tensordict import TensorDict

    from humoslope.env import ManagerBasedRlEnv as Env


@dataclass
class ObservationTermCfg(TermCfg):
    """Observation `func(env, **params) -> [N, d]`, or [N, C, ...] such as an image or a map.

    Attributes:
        noise: Half-width of uniform noise, in the term's own unit, added before the scale.
        scale: Factor on the noisy value.
    """

    noise: NotNegative = 0.0
    scale: Finite = 1.0


def any_noise(env: Env, frame: Tensor) -> Tensor:
    """Returns numbers in [0, 1) from torch's generator, in the shape of `frame` [N, ...]."""
    return torch.rand_like(frame)


class FaultyTerm(StatefulTerm):
    """Term with faults of its own beyond uniform noise, such as holes or a drawn delay.

    Attributes:
        noise_source: The group's source of random numbers (see `ObservationGroupCfg.noise_source`); None where noise is
            disabled. A term that takes all its random numbers from there is the same in the same trial of an
            evaluation; it asks for one shape only, and its own `noise` must be 0, since both would get the same ones.
    """

    noise_source: Callable[..., Tensor] | None = None


@dataclass
class ObservationGroupCfg(StrictCfg):
    """Terms observed together: vectors [N, d], concatenated, or exactly one term of any shape [N, C, ...].

    Attributes:
        terms: Terms in the order of their columns.
        history: Number of control steps that are observed. They are stacked along dimension 1; the frames of each term
            stand together, the oldest first.
        enable_corruption: Add the noise of the terms.
        noise_source: Source of the noise: function of the environment and the frame [N, ...] that returns numbers in
            [0, 1) of the same shape.
    """

    terms: Terms[ObservationTermCfg] = field(default_factory=Terms)
    history: Annotated[int, Range(1, 1000)] = 1
    enable_corruption: bool = False
    noise_source: Callable[..., Tensor] = any_noise


class ObservationManager:
    """Computes every group as a fresh tensor in each step, since the learner keeps references.

    Attributes:
        groups: Description of each group, by name.
    """

    def __init__(self, env: Env, cfg: Terms[ObservationGroupCfg]) -> None:
        self.groups = {name: ObservationGroup(env, name, group) for name, group in cfg.items()}
        self._num_envs = env.num_envs
        self._device = env.device

    def compute(self, restarted: Tensor) -> TensorDict:
        """Returns all groups, [N, *shape] each. The history of envs in `restarted` [N] becomes their first frame."""
        return self._dict({name: group.compute(restarted) for name, group in self.groups.items()})

    def terminal(self) -> TensorDict:
        """Returns what `compute` would return for envs that go on, and changes nothing but torch's generator.

        Called before a reset, it is the last observation of the episodes that end.
        """
        return self._dict({name: group.terminal() for name, group in self.groups.items()})

    def _dict(self, values: dict[str, Tensor]) -> TensorDict:
        from tensordict import TensorDict  # takes longer to import than torch itself, and every task imports this file

        return TensorDict(values, batch_size=[self._num_envs], device=self._device)

    def reset(self, mask: Tensor) -> None:
        """Resets the stateful terms."""
        for group in self.groups.values():
            group.stateful.reset(mask)

    def table(self) -> Table:
        """Table of the groups, their terms, sizes, scales and noise."""
        table = Table("group", "term", "size", "scale", "noise", title="Observations")
        for name, group in self.groups.items():
            noisy = " noisy" if group.cfg.enable_corruption else ""
            table.add_row(name, "", _size(group.shape), "", f"history {group.history}{noisy}", style="bold")
            for term, cfg in group.cfg.terms.items():
                noise = f"±{cfg.noise:g}" if group.cfg.enable_corruption else ""
                table.add_row("", term, _size(group.term_shapes[term]), f"{cfg.scale:g}", noise)
        return table


class ObservationGroup:
    """Computes one group.

    One frame of all terms is a single tensor: one noise draw, one scaling, one history shift.

    Attributes:
        cfg: Configuration of the group.
        history: Number of control steps that are observed.
        term_shapes: Shape of one frame of each term in one env, in the order of their columns.
        shape: Shape of the group's observation in one env, history included.
        stateful: The terms with a memory.
    """

    def __init__(self, env: Env, name: str, cfg: ObservationGroupCfg) -> None:
        check_config(f"observation group '{name}'", cfg)
        if not len(cfg.terms):
            raise UserError(f"observation group '{name}' has no terms.")
        self.env, self.cfg, self.history = env, cfg, cfg.history
        self.stateful = StatefulTerms()
        self._calls = {n: self.stateful.keep(bind("observation", n, t, env)) for n, t in cfg.terms.items()}
        for term, call in self._calls.items():
            if not isinstance(call, FaultyTerm):
                continue
            if cfg.terms[term].noise:
                raise UserError(f"observation '{name}.{term}' has faults of its own; its noise must be 0.")
            call.noise_source = cfg.noise_source if cfg.enable_corruption else None
        self._noisy = cfg.enable_corruption and any(term.noise for _, term in cfg.terms.items())
        self.term_shapes = {term: self._first_shape(f"{name}.{term}", call) for term, call in self._calls.items()}
        # The calls that found the shapes belong to no episode.
        self.stateful.reset(torch.ones(env.num_envs, dtype=torch.bool, device=env.device))
        rest = next(iter(self.term_shapes.values()))[1:]  # shape beyond dimension 1
        if len(self.term_shapes) > 1 and any(len(shape) > 1 for shape in self.term_shapes.values()):
            shaped = next(term for term, shape in self.term_shapes.items() if len(shape) > 1)
            shape = (env.num_envs, *self.term_shapes[shaped])
            raise UserError(
                f"observation '{name}.{shaped}' returned shape {shape}; "
                f"a term that is no vector must be the only one in its group, which has {len(self.term_shapes)}."
            )
        self._widths = [shape[0] for shape in self.term_shapes.values()]
        frame = sum(self._widths)
        self.shape = (frame * self.history, *rest)
        ones = (1,) * len(rest)
        terms = list(zip(self._widths, cfg.terms.items(), strict=True))
        scale = torch.cat([torch.full((width, *ones), float(t.scale)) for width, (_, t) in terms])
        noise = torch.cat([torch.full((width, *ones), float(t.noise)) for width, (_, t) in terms])
        self._scale = scale.to(env.device)  # [D, 1...]
        self._noise = noise.to(env.device) * self._scale
        # The history, the next one while it is made, and the filled one of envs that begin; in single precision.
        each = 3 * 4 * env.num_envs * frame * math.prod(rest)
        require_memory(f"observation group '{name}'.history", self.history, each, device=env.device)
        self._history = env.zeros(*self.shape)  # [N, H * D, ...]
        columns = torch.arange(frame, device=env.device).split(self._widths)
        self._places = torch.cat([column.repeat(self.history) for column in columns])  # [H * D] column of the frame
        sizes = {f"observation '{name}.{term}'": math.prod(shape) for term, shape in self.term_shapes.items()}
        self._watched = env.finite.watch(sizes)

    def _first_shape(self, name: str, call: Callable[..., Any]) -> tuple[int, ...]:
        shape = tuple(first_value("observation", name, call, self.env).shape)
        if len(shape) < 2 or shape[0] != self.env.num_envs:
            n = self.env.num_envs
            raise UserError(f"observation '{name}' returned shape {shape}; it must be ({n}, d) or ({n}, C, ...).")
        return shape[1:]

    def compute(self, restarted: Tensor) -> Tensor:
        """See `ObservationManager.compute`."""
        frame = self._frame(self._calls)
        self._watched.add(frame, self.env.finite.step)
        if self.history == 1:
            return frame
        history = self._shifted(frame)
        if not self.env.sim.known_empty(restarted):
            rows = self.env.sim.known_rows(restarted)
            filled = frame[rows][:, self._places]
            where = restarted[rows].view(-1, *[1] * (frame.dim() - 1))
            history[rows] = torch.where(where, filled, history[rows])
        self._history = history
        return history

    def terminal(self) -> Tensor:
        """See `ObservationManager.terminal`."""
        # Stateful terms are asked in a copy, for they would take a second call in one step for another step. What hangs
        # on the environment is shared with the copy.
        memo = {id(value): value for value in (self.env, *vars(self.env).values())}
        calls = {
            name: copy.deepcopy(call, memo) if isinstance(call, StatefulTerm) else call
            for name, call in self._calls.items()
        }
        frame = self._frame(calls)
        return frame if self.history == 1 else self._shifted(frame)

    def _frame(self, calls: dict[str, Callable[..., Any]]) -> Tensor:
        """Present values of the terms, noisy and scaled, [N, D, ...]."""
        values = torch.cat([call(self.env) for call in calls.values()], dim=1)
        frame = values.to(torch.float32) * self._scale  # no network takes a term in double precision
        if not self._noisy:
            return frame
        uniform = self.cfg.noise_source(self.env, frame)  # in [0, 1)
        return torch.addcmul(frame - self._noise, uniform, 2.0 * self._noise)

    def _shifted(self, frame: Tensor) -> Tensor:
        """The history with `frame` [N, D, ...] in place of its oldest frame; each term's frames stand together."""
        past = self._history.split([width * self.history for width in self._widths], dim=1)
        pairs = zip(past, frame.split(self._widths, dim=1), strict=True)
        return torch.cat([part for old, new in pairs for part in (old[:, new.shape[1] :], new)], dim=1)


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))
