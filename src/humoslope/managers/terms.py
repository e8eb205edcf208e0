"""Named terms: their place in a configuration, and their binding to an environment."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from torch import Tensor

from humoslope import ranges
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

    def update(self, *others: Any, **terms: T | None) -> None:
        """Sets terms as `dict.update` does, by the rules of setting one: None takes a term away."""
        for name, term in dict(*others, **terms).items():
            self[name] = term

    def __or__(self, other: Mapping[str, T]) -> Terms[T]:  # type: ignore[override]
        joined = Terms(**self)
        joined.update(other)
        return joined

    def __ior__(self, other: Mapping[str, T]) -> Terms[T]:  # type: ignore[override]
        self.update(other)
        return self

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
    """Term of a manager.

    Attributes:
        func: Function, or class derived from `StatefulTerm`.
        params: Its arguments beyond the environment.
    """

    func: Callable[..., Any]
    params: dict[str, Any] = field(default_factory=dict)


class StatefulTerm(ABC):
    """Term with a memory between steps; constructed with the environment and the term's parameters."""

    START_ONLY: ClassVar[tuple[str, ...]] = ()
    """Parameters that only a new run reads: a resumed one continues with what its checkpoint holds."""

    @abstractmethod
    def reset(self, mask: Tensor) -> None:
        """Clears the memory of the envs in `mask` [N]."""


def bind(kind: str, name: str, term: TermCfg, env: Env, implicit: tuple[str, ...] = ("env",)) -> Callable[..., Any]:
    """Returns a term as `call(*implicit)`, its parameters filled in.

    Args:
        kind: "reward", "event", ... for messages.
        implicit: Names of the arguments that the manager passes at each call.

    Raises:
        UserError: If the parameters do not fit the signature or the ranges declared there (see `ranges`), or a class is
            not a `StatefulTerm`.
    """
    where = f"{kind} '{name}'"
    if not inspect.isclass(term.func):
        _check_params(where, term, env, implicit)
        return partial(term.func, **term.params)
    if not issubclass(term.func, StatefulTerm) or inspect.isabstract(term.func):
        raise UserError(f"{where}: class {term.func.__name__} must derive from StatefulTerm and define reset(mask).")
    _check_params(where, term, env, ("env",))
    make: Callable[..., Any] = term.func
    try:
        instance: Callable[..., Any] = make(env, **term.params)
    except UserError as error:
        raise UserError(f"{where}: {error}") from None
    return instance


def first_value(kind: str, name: str, call: Callable[..., Any], env: Env) -> Tensor:
    """Value of a bound term in its first call.

    Raises:
        UserError: The term's own error, with the term's name in front.
    """
    try:
        value: Tensor = call(env)
    except UserError as error:
        raise UserError(f"{kind} '{name}': {error}") from None
    return value


def _check_params(where: str, term: TermCfg, env: Env, implicit: tuple[str, ...]) -> None:
    func, params = term.func, term.params
    signature = ranges.parameters_of(func)
    accepted = {name for name in signature if name not in implicit}
    for name in params:
        if name not in accepted:
            raise UserError(f"{where}: {unknown('parameter', name, accepted)}")
    missing = [n for n in accepted if signature[n].default is inspect.Parameter.empty and n not in params]
    if missing:
        raise UserError(f"{where}: parameter '{missing[0]}' of {getattr(func, '__name__', func)} has no value.")
    ranges.check_params(where, func, params, env)


class StatefulTerms:
    """The stateful ones among a manager's terms, reset together."""

    def __init__(self) -> None:
        self._terms: list[StatefulTerm] = []

    def keep(self, call: Callable[..., Any]) -> Callable[..., Any]:
        """Returns `call`, and keeps it to be reset if it is stateful."""
        if isinstance(call, StatefulTerm):
            self._terms.append(call)
        return call

    def reset(self, mask: Tensor) -> None:
        """Resets every stateful term."""
        for term in self._terms:
            term.reset(mask)
