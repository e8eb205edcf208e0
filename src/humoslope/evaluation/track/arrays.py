"""Records of arrays over trials, handled as a whole.

A record is a frozen dataclass whose fields are arrays [T, ...], mappings from names to such arrays, or records.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

R = TypeVar("R")


def map_arrays(function: Callable[..., NDArray[Any]], *records: R) -> R:
    """The record whose every array is `function` of the corresponding arrays of `records`, which are of one type."""
    first: Any = records[0]
    result: Any
    if isinstance(first, Mapping) or is_dataclass(first):
        values = [_items(record) for record in records]
        kind: Any = type(first)
        result = kind(**{name: map_arrays(function, *(value[name] for value in values)) for name in values[0]})
    else:
        result = function(*records)
    return result


def where_arrays(mask: NDArray[np.bool_], first: NDArray[Any], second: NDArray[Any]) -> NDArray[Any]:
    """`first` [T, ...] where `mask` [T] holds, `second` elsewhere."""
    return np.where(mask.reshape(-1, *(1,) * (first.ndim - 1)), first, second)


def to_arrays(record: Any, prefix: str = "") -> dict[str, NDArray[Any]]:
    """All arrays of a record by name; names of nested arrays are prefixed by their field's name and a dot."""
    arrays: dict[str, NDArray[Any]] = {}
    for name, value in _items(record).items():
        nested = is_dataclass(value) or isinstance(value, Mapping)
        arrays.update(to_arrays(value, f"{prefix}{name}.") if nested else {prefix + name: value})
    return arrays


def from_arrays(kind: type[R], arrays: Mapping[str, NDArray[Any]], nested: Mapping[str, type[Any]]) -> R:
    """Inverse of `to_arrays`.

    Args:
        kind: Type of the record.
        nested: Types of the nested fields of all levels by field name; `dict` for a mapping.

    Raises:
        KeyError: If an array is missing.
    """
    values: dict[str, Any] = {}
    for field in fields(kind):  # type: ignore[arg-type]
        if field.name in nested:
            start = f"{field.name}."
            own = {name.removeprefix(start): a for name, a in arrays.items() if name.startswith(start)}
            inner = nested[field.name]
            values[field.name] = own if inner is dict else from_arrays(inner, own, nested)
        else:
            values[field.name] = arrays[field.name]
    return kind(**values)


def _items(record: Any) -> dict[str, Any]:
    return dict(record) if isinstance(record, Mapping) else {f.name: getattr(record, f.name) for f in fields(record)}
