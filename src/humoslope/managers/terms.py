"""Named terms: how a configuration holds them, and how a manager makes them callable."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from torch import Tensor

from humoslope.errors import UserError, unknown
from humoslope.strict import StrictCfg

if TYPE_CHECKING:
    from humoslope.env import ManagerBasedRlEnv as Env

T = TypeVar("T")


class Terms(dict[str, T]):
    """Dictionary of named terms whose entries are attributes too.

    `cfg.rewards.alive.weight = 0.2` changes a term, `cfg.rewards.alive = None` removes it. Names are Python identifiers
    that no method of `dict` has.

    Raises:
        UserError: If a term is read or removed that does not exist (with the nearest match), or a name is not allowed.
    """

    def __init__(self, **terms: T) -> None:
        super().__init__()
        for name, term in terms.items():
            self[name] = term

    def __setitem__(self, name: str, term: T | None) -> None:
        if term is None:
            self.__delattr__(name)
        elif not name.isidentifier() or hasattr(dict, name):
            raise UserError(f"a term cannot be named '{name}'; it must be an identifier and no method of dict.")
        else:
            super().__setitem__(name, term)

    def __getattr__(self, name: str) -> T:
        # Only reached when `dict` has no attribute of that name.
        if name in self:
            return self[name]
        if name.startswith("__"):
            raise AttributeError(name)
        raise unknown("term", name, self)

    def __setattr__(self, name: str, term: T | None) -> None:
        self[name] = term

    def __delattr__(self, name: str) -> None:
        if name not in self:
            raise unknown("term", name, self)
        del self[name]


@dataclass
class TermCfg(StrictCfg):
    """A function or `StatefulTerm` class, and its parameters beyond the environment."""

    func: Callable[..., Any]
    params: dict[str, Any] = field(default_factory=dict)


class StatefulTerm(ABC):
    """A term that remembers something between steps; constructed with the environment and the term's parameters."""

    @abstractmethod
    def reset(self, mask: Tensor) -> None:
        """Forgets what belongs to the envs in `mask` [N]."""


def bind(kind: str, name: str, term: TermCfg, env: Env, implicit: tuple[str, ...] = ("env",)) -> Callable[..., Any]:
    """Makes a term callable as `call(*implicit)`, its parameters filled in.

    Args:
        kind: "reward", "event", ... for messages.
        implicit: Names of the arguments the manager gives at each call.

    Raises:
        UserError: If the parameters do not fit the signature, or a class is not a `StatefulTerm`.
    """
    where = f"{kind} '{name}'"
    if not inspect.isclass(term.func):
        _check_params(where, term.func, term.params, implicit)
        return partial(term.func, **term.params)
    if not issubclass(term.func, StatefulTerm) or inspect.isabstract(term.func):
        raise UserError(f"{where}: class {term.func.__name__} must derive from StatefulTerm and define reset(mask).")
    _check_params(where, term.func, term.params, ("env",))
    make: Callable[..., Any] = term.func
    instance: Callable[..., Any] = make(env, **term.params)
    return instance


def first_value(kind: str, name: str, call: Callable[..., Any], env: Env) -> Tensor:
    """What a bound term gives when it is called for the first time.

    Raises:
        UserError: What the term found wrong, with its name.
    """
    try:
        value: Tensor = call(env)
    except UserError as error:
        raise UserError(f"{kind} '{name}': {error}") from None
    return value


def _check_params(where: str, func: Callable[..., Any], params: Mapping[str, Any], implicit: tuple[str, ...]) -> None:
    signature = inspect.signature(func).parameters
    accepted = {name for name in signature if name not in implicit}
    for name in params:
        if name not in accepted:
            raise UserError(f"{where}: {unknown('parameter', name, accepted)}")
    missing = [n for n in accepted if signature[n].default is inspect.Parameter.empty and n not in params]
    if missing:
        raise UserError(f"{where}: parameter '{missing[0]}' of {getattr(func, '__name__', func)} has no value.")


class StatefulTerms:
    """The stateful ones among a manager's terms, reset together."""

    def __init__(self) -> None:
        self._terms: list[StatefulTerm] = []

    def keep(self, call: Callable[..., Any]) -> Callable[..., Any]:
        """Remembers `call` if it has state; returns it."""
        if isinstance(call, StatefulTerm):
            self._terms.append(call)
        return call

    def reset(self, mask: Tensor) -> None:
        """Resets every stateful term."""
        for term in self._terms:
            term.reset(mask)
