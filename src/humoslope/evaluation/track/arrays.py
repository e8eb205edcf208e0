"""Frozen dataclasses whose fields are arrays over trials, or such dataclasses again, taken as a whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

R = TypeVar("R")


def each(function: Callable[..., NDArray[Any]], *records: R) -> R:
    """A record whose every array is `function` of those arrays of `records`, which are of one kind."""
    first: Any = records[0]
    values = {}
    for field in fields(first):
        parts = [getattr(record, field.name) for record in records]
        values[field.name] = each(function, *parts) if is_dataclass(parts[0]) else function(*parts)
    return type(first)(**values)


def chosen(mask: NDArray[np.bool_], first: NDArray[Any], second: NDArray[Any]) -> NDArray[Any]:
    """`first` [T, ...] where `mask` [T] holds, `second` elsewhere."""
    return np.where(mask.reshape(-1, *(1,) * (first.ndim - 1)), first, second)


def to_arrays(record: Any, prefix: str = "") -> dict[str, NDArray[Any]]:
    """The arrays by name; those of a record within have its field's name and a dot in front."""
    arrays: dict[str, NDArray[Any]] = {}
    for field in fields(record):
        value = getattr(record, field.name)
        inner = to_arrays(value, f"{prefix}{field.name}.") if is_dataclass(value) else {prefix + field.name: value}
        arrays.update(inner)
    return arrays


def from_arrays(kind: type[R], arrays: dict[str, NDArray[Any]], inner: dict[str, type[Any]]) -> R:
    """The record of `kind` that `to_arrays` was given.

    Args:
        inner: The kinds of the fields that are records.

    Raises:
        KeyError: If an array is missing.
    """
    values: dict[str, Any] = {}
    for field in fields(kind):  # type: ignore[arg-type]
        if field.name in inner:
            start = f"{field.name}."
            own = {name.removeprefix(start): a for name, a in arrays.items() if name.startswith(start)}
            values[field.name] = from_arrays(inner[field.name], own, {})
        else:
            values[field.name] = arrays[field.name]
    return kind(**values)
