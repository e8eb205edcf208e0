"""Ranges of parameters, declared at the parameter: `speed: NotNegative`, `soft: Annotated[float, Range(0.0, 1.0)]`.

A declaration is the metadata of an `Annotated` type. It serves parameters of terms, which `managers.terms.bind` checks
when the term is built, and fields of configuration dataclasses, which `check_fields` checks.
"""

from __future__ import annotations

import builtins
import dataclasses
import inspect
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Protocol, get_args, get_origin, get_type_hints, runtime_checkable

from humoslope.errors import UserError


@runtime_checkable
class Declaration(Protocol):
    """Metadata of an `Annotated` parameter that can judge a value."""

    def fault(self, value: Any, env: Any) -> str | None:
        """Returns the end of a sentence such as "it must be positive" if `value` is not acceptable, else None.

        Args:
            env: The environment that the value is meant for, or None if there is none yet.
        """
        ...


@dataclass(frozen=True)
class Range:
    """Real numbers between two bounds. A pair of numbers is a range itself: its lowest and its highest value.

    Attributes:
        low, high: Bounds. Finite ones belong to the range, unless they are open.
        open_low, open_high: The bound itself is outside.
        infinite: Infinity is acceptable, and means that there is no limit.
    """

    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    open_high: bool = False
    infinite: bool = False

    def __contains__(self, value: float) -> bool:
        if math.isinf(value):
            return self.infinite and value > 0.0
        above = value > self.low if self.open_low else value >= self.low
        below = value < self.high if self.open_high else value <= self.high
        return above and below  # False for NaN

    def __str__(self) -> str:
        """The range in words, such as "positive" or "between 0 and 1"."""
        low, high = math.isfinite(self.low), math.isfinite(self.high)
        if low and high:
            ends = {(True, True): ", both excluded", (True, False): f", {self.low:g} excluded"}
            ends[False, True] = f", {self.high:g} excluded"
            words = f"between {self.low:g} and {self.high:g}{ends.get((self.open_low, self.open_high), '')}"
        elif low:
            words = f"more than {self.low:g}" if self.open_low else f"{self.low:g} or more"
            words = "positive" if words == "more than 0" else words
        elif high:
            words = f"less than {self.high:g}" if self.open_high else f"{self.high:g} or less"
        else:
            words = "a finite number"
        return f"{words}, or inf for no limit" if self.infinite else words

    def fault(self, value: Any, env: Any = None) -> str | None:
        """See `Declaration.fault`."""
        if isinstance(value, tuple | list):
            if len(value) == 2 and all(_is_number(v) and v in self for v in value) and value[0] <= value[1]:
                return None
            each = "two finite numbers" if str(self) == "a finite number" else f"each {self}"
            return f"it must be (lowest, highest), {each}"
        return None if _is_number(value) and value in self else f"it must be {self}"


Finite = Annotated[float, Range()]
Positive = Annotated[float, Range(0.0, open_low=True)]
NotNegative = Annotated[float, Range(0.0)]
Share = Annotated[float, Range(0.0, 1.0)]
Limit = Annotated[float, Range(0.0, open_low=True, infinite=True)]
"""A positive bound on something; inf for none."""
Span = Annotated[tuple[float, float], Range()]
"""Lowest and highest value of something that is drawn at random."""
NotNegativeSpan = Annotated[tuple[float, float], Range(0.0)]
PositiveSpan = Annotated[tuple[float, float], Range(0.0, open_low=True)]


def check(where: str, name: str, value: Any, hint: Any, env: Any = None) -> None:
    """Checks a value against its type hint.

    Judged are declarations, the choices of a `Literal`, and True or False for a `bool`. A floating-point number without
    a declaration must be finite.

    Raises:
        UserError: If the value is not acceptable, in one sentence.
    """
    for fault in _faults(value, hint, env):
        raise UserError(f"{where}: {name} is {_shown(value)}; {fault}.")


def check_params(where: str, func: Callable[..., Any], params: Mapping[str, Any], env: Any = None) -> None:
    """Checks the parameters of a function or class, those left at their default among them.

    Args:
        params: By name; what the signature does not know is left out.

    Raises:
        UserError: At the first one that is not acceptable.
    """
    hints = hints_of(func)
    for name, parameter in inspect.signature(func).parameters.items():
        value = params.get(name, parameter.default)
        if value is not inspect.Parameter.empty:
            check(where, name, value, hints.get(name), env)


def check_fields(where: str, cfg: Any) -> None:
    """Checks the fields of a configuration dataclass; what mappings hold, such as `params`, is left out.

    Raises:
        UserError: At the first one that is not acceptable.
    """
    hints = hints_of(type(cfg))
    for field in dataclasses.fields(cfg):
        value = getattr(cfg, field.name)
        if not isinstance(value, Mapping):
            check(where, field.name, value, hints.get(field.name))


def hints_of(thing: Callable[..., Any]) -> dict[str, Any]:
    """Type hints of a function's or class's parameters, or of a dataclass's fields, with their declarations.

    A name that is only imported for type checkers, such as that of the environment, counts as `Any`.
    """
    if not inspect.isclass(thing):
        return get_type_hints(thing, localns=_Names(getattr(thing, "__globals__", {})), include_extras=True)
    if dataclasses.is_dataclass(thing):
        hints: dict[str, Any] = {}
        for base in reversed(thing.__mro__):
            names = _Names(vars(sys.modules[base.__module__]))
            own = inspect.get_annotations(base)
            hints |= {n: eval(a, {}, names) if isinstance(a, str) else a for n, a in own.items()}
        return hints
    return hints_of(thing.__init__)


class _Names(dict[str, Any]):
    """The names of a module; one that is not there at run time is `Any`."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, Any)


def _faults(value: Any, hint: Any, env: Any) -> list[str]:
    metadata = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
    declarations = [part for part in metadata if isinstance(part, Declaration)]
    faults = [declaration.fault(value, env) for declaration in declarations]
    if get_origin(hint) is Literal and value not in get_args(hint):
        faults.append(f"it must be {' or '.join(repr(choice) for choice in get_args(hint))}")
    if hint is bool and not isinstance(value, bool):
        faults.append("it must be True or False")
    elif not declarations and not all(math.isfinite(number) for number in _floats(value)):
        faults.append("it must be finite")
    return [fault for fault in faults if fault is not None]


def _floats(value: Any) -> list[float]:
    """All floating-point numbers in a value, however nested."""
    if isinstance(value, float):
        return [value]
    if isinstance(value, Mapping):
        value = list(value.values())
    return [number for item in value for number in _floats(item)] if isinstance(value, list | tuple) else []


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _shown(value: Any) -> str:
    if isinstance(value, tuple | list):
        return f"({', '.join(_shown(v) for v in value)})"
    return f"{value:g}" if isinstance(value, float) else repr(value)
