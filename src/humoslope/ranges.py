"""Ranges of parameters, declared at the parameter: `speed: NotNegative`, `soft: Annotated[float, Range(0.0, 1.0)]`.

A declaration is the metadata of an `Annotated` type. It serves parameters of terms, which `managers.terms.bind` checks
when the term is built; fields of configuration dataclasses, which `check_config` checks before anything is built; and
options of verbs, which are `Checked`. `--help` shows it, see `in_words`.
"""

from __future__ import annotations

import builtins
import dataclasses
import inspect
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    Protocol,
    Union,
    get_args,
    get_origin,
    get_type_hints,
    runtime_checkable,
)

from humoslope.errors import UserError

SMALLEST, LARGEST = 1e-9, 1e6
"""Sizes between which a number other than zero makes sense, in SI units or as a weight: squares and products of such
numbers stay within single precision."""
SIZES = ("too close to zero", "too large")
"""What is wrong with numbers of other sizes."""
LONGEST = 60
"""Most characters of a value that a message shows."""


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
    """Numbers between two bounds. A pair of numbers is a range itself: its lowest and its highest value.

    Whatever the bounds, a number is finite and of a size that makes sense, see `LARGEST`, except that bounds may be
    further out.

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
        return not self.wrong(value)

    def wrong(self, value: Any) -> str:
        """What is wrong with a single value in two or three words, such as "too low"; "" if it is in the range."""
        found = ""
        if not _is_number(value):
            found = "not a number"
        elif not _is_finite(value) and not (self.infinite and value in (math.inf, -math.inf)):
            found = "not finite"
        elif value < self.low or (self.open_low and value == self.low):
            found = "too low"
        elif value > self.high or (self.open_high and value == self.high):
            found = "too high"
        elif value != 0.0 and abs(value) < SMALLEST:
            found = SIZES[0]
        elif not self._is_bounded and _is_finite(value) and abs(value) > LARGEST:
            found = SIZES[1]
        return found

    @property
    def _is_bounded(self) -> bool:
        return math.isfinite(self.low) and math.isfinite(self.high)

    def __str__(self) -> str:
        """The range in words, such as "positive" or "between 0 and 1"."""
        low, high = math.isfinite(self.low), math.isfinite(self.high)
        least, most = _in_digits(self.low), _in_digits(self.high)
        if low and high:
            ends = {(True, True): ", both excluded", (True, False): f", {least} excluded"}
            ends[False, True] = f", {most} excluded"
            words = f"between {least} and {most}{ends.get((self.open_low, self.open_high), '')}"
        elif low:
            words = f"more than {least}" if self.open_low else f"{least} or more"
            words = "positive" if words == "more than 0" else words
        elif high:
            words = f"less than {most}" if self.open_high else f"{most} or less"
        else:
            words = "a finite number"
        return f"{words}, or inf for no limit" if self.infinite else words

    def fault(self, value: Any, env: Any = None) -> str | None:
        """See `Declaration.fault`."""
        pair = isinstance(value, tuple | list)
        wrong = next(filter(None, map(self.wrong, value if pair else (value,))), "")
        if pair and len(value) != 2:
            wrong = "not two numbers"
        elif pair and not wrong and value[0] > value[1]:
            wrong = "the first is higher"
        if not wrong:
            return None
        asked = str(self)
        if pair:
            each = "two finite numbers" if asked == "a finite number" else f"each {asked}"
            asked = f"(lowest, highest), {each}"
        size = f", of a size between {SMALLEST:g} and {_in_digits(LARGEST)}" if wrong in SIZES else ""
        return f"it must be {asked}{size} ({wrong})"


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
Count = Annotated[int, Range(1, 1_000_000)]
Timestep = Annotated[float, Range(1e-4, 0.05)]
"""A physics step, s."""
Seed = Annotated[int, Range(0, 2**32 - 1)]


@dataclass(frozen=True)
class NotEmpty:
    """Declaration of a sequence with at least one item."""

    def fault(self, value: Any, env: Any) -> str | None:
        """See `Declaration.fault`."""
        return None if len(value) else "it must have at least one"


def check(where: str, name: str, value: Any, hint: Any, env: Any = None) -> None:
    """Checks a value against its type hint.

    Judged are declarations, the choices of a `Literal`, and whether a number, a truth value or a text is one. A number
    without a declaration must be finite.

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
    for name, parameter in parameters_of(func).items():
        value = params.get(name, parameter.default)
        if value is not inspect.Parameter.empty:
            check(where, name, value, hints.get(name), env)


def check_config(path: str, cfg: Any) -> None:
    """Checks every field of a configuration dataclass, and of those that it holds, also in mappings.

    What a term's `params` may be is declared at the term's function, and is checked when the term is bound.

    Args:
        path: Name of the whole, such as "env"; a field is then called "env.sim.timestep", as on the command line.

    Raises:
        UserError: At the first one that is not acceptable, in one sentence.
    """
    hints = hints_of(type(cfg))
    for field in dataclasses.fields(cfg):
        name, value, hint = f"{path}.{field.name}", getattr(cfg, field.name), hints.get(field.name)
        if dataclasses.is_dataclass(value):
            check_config(name, value)
        elif isinstance(value, Mapping) and any(dataclasses.is_dataclass(item) for item in value.values()):
            for key, item in value.items():
                check_config(f"{name}.{key}", item)
        elif field.name != "params":
            for fault in _faults(value, hint, None):
                raise UserError(f"{name} is {_shown(value)}; {fault}.")


class Checked:
    """Base of dataclasses of options: whenever one is made, every field is checked against its declared range.

    Attributes:
        VERB: What the options are for; messages begin with it.
    """

    VERB: ClassVar[str]

    def __post_init__(self) -> None:
        hints = hints_of(type(self))
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            check(self.VERB, field.name, getattr(self, field.name), hints.get(field.name))


def in_words(hint: Any) -> str:
    """The declared range of a parameter or field, such as "positive"; "" if its type hint declares none."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        declared = [str(part) for part in arguments[1:] if isinstance(part, Range)]
        each = "each " if get_origin(arguments[0]) is tuple else ""
        return f"{each}{declared[0]}" if declared else in_words(arguments[0])
    if origin in (Union, UnionType):
        return next((words for words in map(in_words, arguments) if words), "")
    if inspect.isclass(origin) and issubclass(origin, tuple | Mapping):
        words = next((words for words in map(in_words, arguments) if words), "")
        return words and f"each {words}"
    return ""


@cache
def parameters_of(func: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    """Parameters of a function or class by name. Kept: an environment asks for those of every term, twice."""
    return inspect.signature(func).parameters


def hints_of(thing: Callable[..., Any]) -> dict[str, Any]:
    """Type hints of a function's or class's parameters, or of a dataclass's fields, with their declarations.

    A name that is only imported for type checkers, such as that of the environment, counts as `Any`.
    """
    return _hints_of(thing)


@cache
def _hints_of(thing: Any) -> dict[str, Any]:
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
    """What is wrong with a value by its type hint, each as the end of a sentence."""
    origin, arguments = get_origin(hint), get_args(hint)
    found: list[str]
    if origin in (Union, UnionType):
        kinds = [kind for kind in arguments if kind is not NoneType]
        absent = value is None and len(kinds) < len(arguments)
        found = [] if absent else min((_faults(value, kind, env) for kind in kinds), key=len)
    elif origin is Annotated:
        found = _declared_faults(value, arguments[0], arguments[1:], env)
    elif origin is Literal:
        found = [] if value in arguments else [f"it must be {' or '.join(map(repr, arguments))}"]
    elif origin is tuple and arguments[-1] is ...:
        found = _wrong_type(value, hint) or [
            f"of each, {said}" for v in value for said in _faults(v, arguments[0], env)
        ]
    elif inspect.isclass(origin) and issubclass(origin, Mapping) and isinstance(value, Mapping):
        found = [f"of '{key}', {said}" for key, v in value.items() for said in _faults(v, arguments[1], env)]
    else:
        finite = all(math.isfinite(number) for number in _floats(value))
        found = _wrong_type(value, hint) or ([] if finite else ["it must be finite"])
    return found


def _declared_faults(value: Any, base: Any, metadata: tuple[Any, ...], env: Any) -> list[str]:
    declarations = [part for part in metadata if _judges(part.__class__)]
    several = get_origin(base) is tuple
    found = _wrong_type(value, base) if base is int or (several and get_args(base)[-1] is ...) else []
    found = found or [said for one in declarations if (said := one.fault(value, env)) is not None]
    return found or (_faults(value, base, env) if several or not declarations else [])


@cache
def _judges(kind: type) -> bool:
    """Whether it is a `Declaration`, which Python finds out slowly."""
    return issubclass(kind, Declaration)


def _wrong_type(value: Any, hint: Any) -> list[str]:
    """What is wrong with the type of a value, as far as one of the plain types is asked for."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    whole = number and isinstance(value, int)  # 8.0 would fail later, where something is counted with it
    asked: dict[Any, tuple[bool, str]] = {
        bool: (isinstance(value, bool), "True or False"),
        int: (whole, "a whole number"),
        float: (number, "a number"),
        str: (isinstance(value, str), "a text"),
    }
    if get_origin(hint) is tuple:
        return [] if isinstance(value, tuple | list) else ["it must be a list"]
    fits, kind = asked.get(hint, (True, ""))
    if inspect.isclass(hint) and dataclasses.is_dataclass(hint):
        fits, kind = isinstance(value, hint), f"a {hint.__name__}"
    return [] if fits else [f"it must be {kind}"]


def _floats(value: Any) -> list[float]:
    """All floating-point numbers in a value, however nested."""
    if isinstance(value, float):
        return [value]
    if isinstance(value, Mapping):
        value = list(value.values())
    return [number for item in value for number in _floats(item)] if isinstance(value, list | tuple) else []


def _in_digits(value: float) -> str:
    """A number as people write it: 1,000,000 or 0.05."""
    return f"{int(value):,}" if math.isfinite(value) and value == int(value) else f"{value:g}"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_finite(value: float) -> bool:
    return isinstance(value, int) or math.isfinite(value)  # a whole number may be too large for a float


def _shown(value: Any) -> str:
    if isinstance(value, tuple | list):
        shown = f"({', '.join(_shown(v) for v in value)})"
    elif isinstance(value, float):
        shown = f"{value:g}"
    elif isinstance(value, int) and abs(value) >= 10**20:
        shown = f"about {'-' if value < 0 else ''}1e{round(math.log10(2) * value.bit_length())}"
    else:
        shown = repr(value)
    return shown if len(shown) <= LONGEST else f"{shown[:LONGEST]}..."
