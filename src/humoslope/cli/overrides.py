"""Rules by which tyro shows the fields of a task's configuration as options.

tyro lists dataclasses, mappings and choices by itself. It is told here that `Terms` are listed by name, that a term has
the parameters of its function as options, also those that the task leaves to their defaults, and that a robot is fixed.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from functools import cache, partial
from types import SimpleNamespace
from typing import Annotated, Any, get_type_hints

from tyro.conf import Fixed
from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructFieldSpec, StructTypeInfo

from humoslope.cli.arguments import checked, docstring, help_of
from humoslope.managers.terms import TermCfg, Terms
from humoslope.ranges import parameters_of
from humoslope.scene.robot import Robot
from humoslope.strict import StrictCfg
from humoslope.terrain.grid import TerrainGridCfg


class _Params(dict[str, Any]):
    """Parameters of a term in the command line's eyes: its own, and the defaults of its function."""

    def __init__(self, term: TermCfg) -> None:
        self.defaults = _defaults_of(term.func)
        super().__init__(self.defaults | term.params)
        self.func, self.set = term.func, term.params

    def parsed(self, **values: Any) -> dict[str, Any]:
        """The term's parameters after parsing; a default that was not changed stays with the function."""
        return {k: v for k, v in values.items() if k in self.set or v != self.defaults[k]}


def task_rules() -> ConstructorRegistry:
    """Rules for the configuration of a task."""
    registry = ConstructorRegistry()
    for rule in (_terms, _term, _params, _mapping, _robot, _config, checked):
        registry.struct_rule(rule)
    return registry


def _terms(info: StructTypeInfo) -> StructConstructorSpec | None:
    if not isinstance(info.default, Terms):
        return None
    fields = [StructFieldSpec(name, type(term), term, partial(_summary, term)) for name, term in info.default.items()]
    return StructConstructorSpec(type(info.default), tuple(fields))


def _term(info: StructTypeInfo) -> StructConstructorSpec | None:
    if not isinstance(info.default, TermCfg):
        return None
    term: TermCfg = info.default
    kind: Any = type(term)
    hints, own = _hints_of(kind), [f.name for f in dataclasses.fields(kind) if f.name not in ("func", "params")]
    fields = [StructFieldSpec(name, hints[name], getattr(term, name), partial(help_of, kind, name)) for name in own]
    fields.append(StructFieldSpec("params", _Params, _Params(term), ""))
    return StructConstructorSpec(partial(dataclasses.replace, term), tuple(fields))


def _params(info: StructTypeInfo) -> StructConstructorSpec | None:
    if not isinstance(info.default, _Params):
        return None
    func, values = info.default.func, info.default.items()
    fields = [StructFieldSpec(k, _parameter_type(func, k, v), v, partial(help_of, func, k)) for k, v in values]
    return StructConstructorSpec(info.default.parsed, tuple(fields))


def _mapping(info: StructTypeInfo) -> StructConstructorSpec | None:
    if not isinstance(info.default, Mapping) or isinstance(info.default, Terms | _Params):
        return None
    fields = [StructFieldSpec(k, type(v), v, f"Value for '{k}', see above.") for k, v in info.default.items()]
    return StructConstructorSpec(dict, tuple(fields))


def _robot(info: StructTypeInfo) -> StructConstructorSpec | None:
    # Its model would not follow its fields.
    return StructConstructorSpec(lambda: info.default, ()) if isinstance(info.default, Robot) else None


def _config(info: StructTypeInfo) -> StructConstructorSpec | None:
    # As tyro would list it, but with the ranges in the help.
    if not isinstance(info.default, StrictCfg | TerrainGridCfg) or isinstance(info.default, TermCfg):
        return None
    cfg: Any = info.default
    hints, values = _hints_of(cfg.__class__), {f.name: getattr(cfg, f.name) for f in dataclasses.fields(cfg)}
    fields = []
    for name, value in values.items():
        kind = type(value) if dataclasses.is_dataclass(value) else hints[name]
        fields.append(StructFieldSpec(name, kind, value, partial(help_of, type(cfg), name)))
    return StructConstructorSpec(partial(dataclasses.replace, cfg), tuple(fields))


def _parameter_type(func: Callable[..., Any], name: str, value: Any) -> Any:
    """Annotated type of a parameter of `func`, or else the type of its value."""
    annotated = _annotated_type(func, name)
    if annotated is None:
        return Annotated[Any, Fixed] if value is None else type(value)
    return annotated


# What tyro asks for twice an option, and again with every command line, never changes.


@cache
def _annotated_type(func: Callable[..., Any], name: str) -> Any:
    """Annotated type of a parameter of `func`; None if it has none, or one that is imported for type checking alone."""
    function: Any = func.__init__ if inspect.isclass(func) else func
    annotations = {k: v for k, v in function.__annotations__.items() if k == name}
    try:
        return get_type_hints(SimpleNamespace(__annotations__=annotations), function.__globals__)[name]
    except (KeyError, NameError):
        return None


@cache
def _defaults_of(func: Callable[..., Any]) -> dict[str, Any]:
    """Defaults of the parameters of `func`; not to be written into."""
    parameters = parameters_of(func).values()
    return {p.name: p.default for p in parameters if p.default is not inspect.Parameter.empty}


@cache
def _hints_of(kind: type) -> dict[str, Any]:
    """Type hints of a dataclass's fields."""
    return get_type_hints(kind)


def _summary(thing: Any) -> str:
    """First lines of the docstring of a term's function, or of a group's class."""
    subject = thing.func if isinstance(thing, TermCfg) else type(thing)
    return docstring(subject.__doc__ or "").short_description or ""
