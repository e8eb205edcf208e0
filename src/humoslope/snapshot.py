"""The memory of living objects, taken from their attributes and put back into equal objects.

Managers, terms and their helpers keep their memory in tensors and numbers, as attributes. Walking over the attributes
finds all of it without a method in each class, and cannot forget a term. What lies elsewhere, in closures, modules or
NumPy generators, is not found.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any

from torch import Tensor

Memory = dict[str, dict[str, Any]]
"""Attributes by the path of the object that has them: tensors, numbers, None, and lists or tuples of tensors."""

OPAQUE = (FunctionType, MethodType, BuiltinFunctionType, ModuleType, partial, type, str, bytes, Tensor)


def take(roots: Mapping[str, object], others: Iterable[object], is_lent: Callable[[Tensor], bool]) -> Memory:
    """Copies the memory of objects and of all that they hold.

    Args:
        roots: The objects by name.
        others: Objects that are met on the way and do not belong to them.
        is_lent: True for a tensor whose memory belongs to something else, such as the physics.
    """
    return {
        path: {name: _copy(value) for name, value in _remembered(holder, is_lent).items()}
        for path, holder in _walk(roots, others)
    }


def check(
    memory: Memory, roots: Mapping[str, object], others: Iterable[object], is_lent: Callable[[Tensor], bool]
) -> None:
    """Checks that a memory is one of objects of this structure: one that other code took may lack what these objects
    remember, or have it by another name.

    Raises:
        ValueError: If not.
    """
    left = dict(memory)
    for path, holder in _walk(roots, others):
        then, now = left.pop(path, {}), dict(_items(holder))
        if unknown := then.keys() - now.keys():
            raise ValueError(f"{path} has no {min(unknown)}")
        if forgotten := _remembered(holder, is_lent).keys() - then.keys():
            raise ValueError(f"nothing is known of {path}.{min(forgotten)}")
    if left:
        raise ValueError(f"there is no {min(left)}")


def size(roots: Mapping[str, object], others: Iterable[object], is_lent: Callable[[Tensor], bool]) -> int:
    """Bytes of the tensors that `take` would copy."""
    found = 0
    for _, holder in _walk(roots, others):
        for value in _remembered(holder, is_lent).values():
            tensors = value if _is_row(value) else [value] if isinstance(value, Tensor) else []
            found += sum(tensor.nbytes for tensor in tensors)
    return found


def put(memory: Memory, roots: Mapping[str, object], others: Iterable[object]) -> None:
    """Gives a memory that was taken to objects of the same structure (see `check`). Its tensors are theirs from then
    on."""
    for path, holder in _walk(roots, others):
        for name, value in memory.get(path, {}).items():
            if isinstance(holder, dict):
                holder[name] = value
            else:
                setattr(holder, name, value)


def _remembered(holder: Any, is_lent: Callable[[Tensor], bool]) -> dict[str, Any]:
    """What an object remembers, by attribute."""
    return {name: value for name, value in _items(holder) if _is_memory(value, is_lent)}


def _is_memory(value: Any, is_lent: Callable[[Tensor], bool]) -> bool:
    if isinstance(value, Tensor):
        return not is_lent(value)
    if _is_row(value):
        return not any(map(is_lent, value))
    return value is None or isinstance(value, bool | int | float)


def _copy(value: Any) -> Any:
    if isinstance(value, Tensor):
        return value.clone()
    return type(value)(tensor.clone() for tensor in value) if _is_row(value) else value


def _walk(roots: Mapping[str, object], others: Iterable[object]) -> list[tuple[str, Any]]:
    """Every object with attributes, and every dictionary, once, with the path that it was first met at."""
    seen, found = {id(other) for other in others}, []
    waiting = list(roots.items())
    while waiting:
        path, thing = waiting.pop(0)
        if id(thing) in seen or isinstance(thing, OPAQUE) or dataclasses.is_dataclass(thing):
            continue
        seen.add(id(thing))
        if isinstance(thing, list | tuple):
            waiting += [(f"{path}[{i}]", item) for i, item in enumerate(thing)]
        elif isinstance(thing, dict) or hasattr(thing, "__dict__"):
            found.append((path, thing))
            waiting += [(f"{path}.{name}", value) for name, value in _items(thing)]
    return found


def _items(thing: Any) -> list[tuple[str, Any]]:
    items = thing.items() if isinstance(thing, dict) else vars(thing).items()
    return [(name, value) for name, value in items if isinstance(name, str)]


def _is_row(value: Any) -> bool:
    return isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(item, Tensor) for item in value)
