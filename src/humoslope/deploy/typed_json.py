"""Conversion of JSON into frozen dataclasses, with a clear message for every mismatch."""

from __future__ import annotations

import math
from dataclasses import MISSING, fields, is_dataclass
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from humoslope.errors import UserError, unknown

T = TypeVar("T")


def typed(kind: type[T], value: Any, where: str = "") -> T:
    """Converts `value`, as `json` reads it, to an instance of the dataclass `kind`.

    Args:
        kind: The dataclass.
        value: The JSON value.
        where: Path of the value in its file, for messages.

    Raises:
        UserError: If a field is missing, unknown, or of another type.
    """
    made: T = _dataclass(kind, value, where)
    return made


def _dataclass(kind: Any, value: Any, where: str) -> Any:
    if not isinstance(value, dict):
        raise UserError(f"{where or 'the file'} must be an object with fields.")
    hints = get_type_hints(kind)
    for name in value:
        if name not in hints:
            raise unknown("field", _join(where, name), [_join(where, known) for known in hints])
    given = {}
    for field in fields(kind):
        path = _join(where, field.name)
        if field.name in value:
            given[field.name] = _convert(hints[field.name], value[field.name], path)
        elif field.default is MISSING:
            raise UserError(f"field '{path}' is missing.")
    return kind(**given)


def _convert(kind: Any, value: Any, where: str) -> Any:
    if is_dataclass(kind):
        return _dataclass(kind, value, where)
    origin, args = get_origin(kind), get_args(kind)
    if origin is UnionType:
        if value is None and NoneType in args:
            return None
        (kind,) = (arg for arg in args if arg is not NoneType)
        return _convert(kind, value, where)
    if origin is Literal:
        if value not in args:
            raise UserError(f"{where} is {_shown(value)}; this version reads only {', '.join(map(_shown, args))}.")
        return value
    if origin is tuple:
        return _tuple(args, value, where)
    return _scalar(kind, value, where)


def _scalar(kind: type, value: Any, where: str) -> Any:
    accepted: Any = (int, float) if kind is float else kind
    # JSON distinguishes true from 1; in Python a bool is an int.
    fits = isinstance(value, accepted) and isinstance(value, bool) == (kind is bool)
    if fits and (kind is not float or _is_float(value)):
        return kind(value)
    wanted = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}[kind]
    raise UserError(f"{where} is {_shown(value)}; it must be {wanted}.")


def _is_float(value: float) -> bool:
    """True for a number that a float can hold; JSON has integers of any length."""
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _tuple(args: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise UserError(f"{where} is {_shown(value)}; it must be a list.")
    if args[-1] is not ...:
        if len(value) != len(args):
            raise UserError(f"{where} has {len(value)} entries; it must have {len(args)}.")
        kinds: tuple[Any, ...] = args
    else:
        kinds = (args[0],) * len(value)
    return tuple(_convert(k, v, f"{where}[{i}]") for i, (k, v) in enumerate(zip(kinds, value, strict=True)))


def _join(where: str, name: str) -> str:
    return f"{where}.{name}" if where else name


def _shown(value: Any) -> str:
    text = f"'{value}'" if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
