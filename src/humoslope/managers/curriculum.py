"""Curricula: what gets harder as the policy gets better."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.table import Table
from torch import Tensor

from humoslope.errors import unknown
from humoslope.managers.terms import StatefulTerm, TermCfg, Terms, bind

if TYPE_CHECKING:
    from collections.abc import Callable

    from humoslope.env import ManagerBasedRlEnv as Env


class CurriculumManager:
    """Calls each term with the worlds that are about to be reset.

    A term is `func(env, mask, **params) -> Tensor`, the difficulty it logs.
    A class may define `state_dict` and `load_state_dict`; they go into the checkpoint.
    """

    def __init__(self, env: Env, cfg: Terms[TermCfg]) -> None:
        self._env = env
        self._calls: dict[str, Callable[..., Any]] = {}
        env.curriculum = self  # a term may build on one before it
        for name, term in cfg.items():
            self._calls[name] = bind("curriculum", name, term, env, ("env", "mask"))

    def __getitem__(self, name: str) -> Any:
        """The term called `name`.

        Raises:
            UserError: If there is none.
        """
        if name not in self._calls:
            raise unknown("curriculum", name, self._calls)
        return self._calls[name]

    def reset(self, mask: Tensor) -> None:
        """Lets every term look at the episodes that end in `mask`, before their worlds are reset."""
        for name, call in self._calls.items():
            self._env.log.add(f"Curriculum/{name}", call(self._env, mask))
            if isinstance(call, StatefulTerm):
                call.reset(mask)

    def state_dict(self) -> dict[str, Any]:
        """What a resumed run needs."""
        return {name: call.state_dict() for name, call in self._calls.items() if hasattr(call, "state_dict")}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what `state_dict` gave; terms that are new keep their start."""
        for name, value in state.items():
            if name in self._calls:
                self[name].load_state_dict(value)

    def table(self) -> Table:
        """What gets harder."""
        table = Table("curriculum", "parameters", title="Curricula")
        for name, term in self._env.cfg.curriculum.items():
            table.add_row(name, ", ".join(f"{k}={v}" for k, v in term.params.items()))
        return table
