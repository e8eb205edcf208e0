"""Curricula: difficulty that follows the skill of the policy."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any

import torch
from rich.table import Table
from torch import Tensor

from humoslope.errors import UserError, unknown
from humoslope.managers.terms import StatefulTerm, TermCfg, Terms, bind

if TYPE_CHECKING:
    from collections.abc import Callable

    from humoslope.env import ManagerBasedRlEnv as Env


class CurriculumTerm(StatefulTerm):
    """Curriculum with a memory; constructed with the environment and the term's parameters."""

    def begin(self, env: Env) -> None:
        """Called before the first episodes of a run begin, and before those of a resumed run, once every curriculum has
        its state: what episodes begin with is set here, and in `step` from then on."""

    @abstractmethod
    def step(self, env: Env) -> Tensor:
        """Called in every control step, before any reset. Returns the difficulty to log, a scalar or [N]."""

    def reset(self, mask: Tensor) -> None:
        """Called when episodes end, before the envs in `mask` [N] are reset: the last sight of those episodes."""

    def state_dict(self) -> dict[str, Any]:
        """State for the checkpoint; empty by default."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores the result of `state_dict`."""

    def average(self, mean: Callable[[Tensor], Tensor]) -> None:
        """Shares the difficulty between the processes of a distributed run; by default each keeps its own.

        Args:
            mean: Returns the mean of a tensor over all processes.
        """


class CurriculumManager:
    """Runs the curricula.

    A term is a `CurriculumTerm`, or a function `func(env, mask, **params)` that is called with the envs about to be
    reset and returns the difficulty to log: a tensor, scalar or [N], a number, or None for nothing to log.
    """

    def __init__(self, env: Env, cfg: Terms[TermCfg]) -> None:
        self._env = env
        self._terms: dict[str, CurriculumTerm] = {}
        self._functions: dict[str, Callable[..., Tensor | float | None]] = {}
        for name, term in cfg.items():
            call = bind("curriculum", name, term, env, ("env", "mask"))
            if isinstance(call, CurriculumTerm):
                self._terms[name] = call
            elif isinstance(call, StatefulTerm):
                raise UserError(f"curriculum '{name}': class {type(call).__name__} must derive from CurriculumTerm.")
            else:
                self._functions[name] = call

    def __getitem__(self, name: str) -> CurriculumTerm:
        """Returns the `CurriculumTerm` called `name`.

        Raises:
            UserError: If there is none.
        """
        if name not in self._terms:
            raise unknown("curriculum", name, self._terms)
        return self._terms[name]

    def begin(self) -> None:
        """Lets every `CurriculumTerm` set what the first episodes begin with."""
        for term in self._terms.values():
            term.begin(self._env)

    def step(self) -> None:
        """Steps every `CurriculumTerm` and logs its difficulty. Called in every control step."""
        for name, term in self._terms.items():
            self._env.log.add(f"Curriculum/{name}", term.step(self._env))

    def reset(self, mask: Tensor) -> None:
        """Shows every term the episodes that end in `mask` [N]. Called only if some may end, before they are reset."""
        for name, function in self._functions.items():
            difficulty = function(self._env, mask)
            if isinstance(difficulty, int | float):
                difficulty = torch.full((), difficulty, device=self._env.device)
            if difficulty is not None:
                self._env.log.add(f"Curriculum/{name}", difficulty)
        for term in self._terms.values():
            term.reset(mask)

    def state_dict(self) -> dict[str, Any]:
        """State of the terms that have one, by name."""
        states = {name: term.state_dict() for name, term in self._terms.items()}
        return {name: state for name, state in states.items() if state}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores the result of `state_dict`; terms that are not in it keep their initial state."""
        for name, value in state.items():
            if name in self._terms:
                self._terms[name].load_state_dict(value)

    def average(self, mean: Callable[[Tensor], Tensor]) -> None:
        """Shares the difficulties between processes; see `CurriculumTerm.average`."""
        for term in self._terms.values():
            term.average(mean)

    def table(self) -> Table:
        """Table of the curricula and their parameters."""
        table = Table("curriculum", "parameters", title="Curricula")
        for name, term in self._env.cfg.curriculum.items():
            table.add_row(name, ", ".join(f"{k}={v}" for k, v in term.params.items()))
        return table
