"""Any field of a configuration as a command-line option.

tyro needs a type whose fields it can list. Configurations hold named terms and free parameters as well as dataclasses,
so a dataclass with the same structure is made from the values themselves, shown to tyro, and what came back is written
into the configuration.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Callable, Iterator
from functools import lru_cache
from typing import Annotated, Any, Literal, get_origin, get_type_hints

import tyro

from humoslope.managers.terms import TermCfg, Terms
from humoslope.scene.robot import Robot

PLAIN = (bool, int, float, str)


def mirror_type(name: str, value: Any, helps: dict[str, str] | None = None) -> tuple[type, Any] | None:
    """A dataclass type with the fields of `value` that can be written on a command line,
    and an instance with its values.

    None if there are none. `helps` says what the fields are; by default the docstring of the value's class does.
    """
    fields: list[tuple[str, Any, Any]] = []
    values: dict[str, Any] = {}
    hints = _hints(value)
    described_by: Any = type(value)
    helps = documented(described_by, "Attributes") if helps is None else helps
    for key, child in _children(value).items():
        kind, default = hints.get(key, _annotation(child)), child
        if kind is None:
            if isinstance(value, TermCfg) and key == "params":
                whole = _defaults(value.func) | child
                nested = mirror_type(f"{name}_{key}", whole, documented(value.func, "Args"))
            else:
                nested = mirror_type(f"{name}_{key}", child)
            if nested is None:
                continue
            kind, default = nested
        # With the help given here tyro does not look for it in sources, which takes it seconds.
        described = Annotated[kind, tyro.conf.arg(help=helps.get(key, ""))]  # type: ignore[valid-type]
        fields.append((key, described, dataclasses.field(default=default)))
        values[key] = default
    if not fields:
        return None
    made = dataclasses.make_dataclass(name, fields, frozen=True)
    return made, made(**values)


def write_back(value: Any, mirror: Any) -> None:
    """Writes the fields of `mirror`, made by `mirror_type`, into the configuration `value`."""
    for field in dataclasses.fields(mirror):
        new = getattr(mirror, field.name)
        # What a term's parameters leave to their defaults is in the mirror alone.
        old = _children(value).get(field.name, field.default)
        if _annotation(old) is None:
            if dataclasses.is_dataclass(old) and not isinstance(old, type) and old.__dataclass_params__.frozen:  # type: ignore[attr-defined]
                _set(value, field.name, _replaced(old, new))
            else:
                write_back(old, new)
        elif new != old:
            _set(value, field.name, new)


def option_names(mirror: Any, prefix: str = "--") -> Iterator[str]:
    """The options that an instance made by `mirror_type` has on the command line,
    such as --env.rewards.alive.weight."""
    for field in dataclasses.fields(mirror):
        value, name = getattr(mirror, field.name), prefix + field.name.replace("_", "-")
        if dataclasses.is_dataclass(value):
            yield from option_names(value, f"{name}.")
        else:
            yield name


def merge_options(first: list[str], then: list[str], without: tuple[str, ...] = ()) -> list[str]:
    """Both lists of options as one, in which what comes later replaces what is of the same name.

    Args:
        without: Names to leave out.
    """
    groups = option_groups([*first, *then])
    return [word for name, words in groups.items() if name not in without for word in words]


def option_groups(options: list[str]) -> dict[str, list[str]]:
    """Each option's words by its name, however that was spelt. Of options with the same name the last one holds."""
    groups: dict[str, list[str]] = {}
    name = ""
    for word in options:
        if word.startswith("--"):
            name = word.partition("=")[0].replace("_", "-")
            groups.pop(name, None)
        groups.setdefault(name, []).append(word)
    return groups


def _replaced(old: Any, mirror: Any) -> Any:
    changes = {f.name: getattr(mirror, f.name) for f in dataclasses.fields(mirror)}
    plain = {k: v for k, v in changes.items() if _annotation(getattr(old, k)) is not None}
    changed = dict(plain)
    for name in changes.keys() - plain.keys():
        mapping = getattr(old, name)
        changed[name] = dict(mapping) | {_keys(mapping)[k]: v for k, v in dataclasses.asdict(changes[name]).items()}
    return dataclasses.replace(old, **changed) if any(getattr(old, k) != v for k, v in changed.items()) else old


def _set(value: Any, key: str, new: Any) -> None:
    if isinstance(value, dict):
        value[_keys(value).get(key, key)] = new
    else:
        setattr(value, key, new)


def _children(value: Any) -> dict[str, Any]:
    if isinstance(value, Robot):
        return {}  # what it is, not how it is used: its model would not follow
    if isinstance(value, Terms):
        return dict(value.items())
    if isinstance(value, dict):
        return {field: value[key] for field, key in _keys(value).items()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    return {}


def _defaults(func: Callable[..., Any]) -> dict[str, Any]:
    """The parameters of a term that have a value of their own."""
    parameters = inspect.signature(func).parameters.values()
    return {p.name: p.default for p in parameters if p.default is not inspect.Parameter.empty}


def _keys(mapping: dict[str, Any]) -> dict[str, str]:
    """Field names for the keys of a mapping: "ramp-up" becomes ramp_up, as a Python name and as an option."""
    return {key.replace("-", "_"): key for key in mapping if key.replace("-", "_").isidentifier()}


def _hints(value: Any) -> dict[str, Any]:
    """Types of a dataclass's fields that its values alone do not tell: choices, and numbers that need not be whole."""
    if not dataclasses.is_dataclass(value):
        return {}
    try:
        hints = get_type_hints(type(value))
    except NameError:  # of a type that is only imported for type checking
        return {}
    return {name: hint for name, hint in hints.items() if hint is float or get_origin(hint) is Literal}


@lru_cache(maxsize=1024)
def documented(thing: Any, section: str) -> dict[str, str]:
    """What a docstring says of each name in its section "Attributes" or "Args"."""
    _, _, entries = inspect.cleandoc(thing.__doc__ or "").partition(f"{section}:\n")
    found = re.finditer(r"^    ([\w, ]+): (.*(?:\n {8}.*)*)", entries, re.MULTILINE)
    return {name: " ".join(m[2].split()) for m in found for name in m[1].split(", ")}


def _annotation(value: Any) -> Any:
    """The type of a value that can be written on a command line, or None."""
    if isinstance(value, PLAIN):
        return type(value)
    if isinstance(value, tuple) and value and all(isinstance(v, PLAIN) for v in value):
        kinds = {type(v) for v in value}
        if len(kinds) > 1:
            return None
        kind = kinds.pop()
        return tuple[kind, ...] if kind is int else tuple[tuple([kind] * len(value))]  # type: ignore[valid-type, misc]
    return None
