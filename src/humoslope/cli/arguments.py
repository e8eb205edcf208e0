"""Options of a verb: read from the command line, checked against their declared ranges, which the help shows."""

from __future__ import annotations

import dataclasses
import inspect
from functools import cache, partial
from typing import Any, TypeVar

import docstring_parser
import tyro
from docstring_parser import Docstring
from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructFieldSpec, StructTypeInfo

from humoslope.ranges import Checked, hints_of, in_words

O = TypeVar("O", bound=Checked)  # noqa: E741


def parse_options(kind: type[O], arguments: list[str], verb: str, default: O | None = None) -> O:
    """The options of a verb.

    An option that does not exist ends the process with exit code 2 and the nearest match.

    Args:
        kind: Dataclass of the options.
        default: Values of those that are not given; by default those of the class.

    Raises:
        UserError: If a value is outside its range.
    """
    registry = ConstructorRegistry()
    registry.struct_rule(checked)
    given: dict[str, Any] = {} if default is None else {"default": default}
    about = docstring(kind.__doc__ or "")
    words = "\n\n".join(filter(None, (about.short_description, about.long_description)))
    return tyro.cli(kind, args=arguments, prog=f"humoslope {verb}", description=words, registry=registry, **given)


def checked(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Rule by which tyro shows a `Checked` dataclass: as it would, but with the ranges in the help."""
    kind: Any = info.type
    if not inspect.isclass(kind) or not issubclass(kind, Checked) or not dataclasses.is_dataclass(kind):
        return None
    hints, fields = hints_of(kind), []
    for field in dataclasses.fields(kind):
        if not field.init:
            continue
        if isinstance(info.default, kind):
            value = getattr(info.default, field.name)
        elif field.default_factory is not dataclasses.MISSING:
            value = field.default_factory()
        else:
            value = tyro.MISSING if field.default is dataclasses.MISSING else field.default
        fields.append(StructFieldSpec(field.name, hints[field.name], value, partial(help_of, kind, field.name)))
    return StructConstructorSpec(kind, tuple(fields))


# Docstrings are read for the help alone, which tyro asks for when it prints an option, or lists a group of them.


@cache
def docstring(text: str) -> Docstring:
    """The parts of a docstring. Kept, because reading it takes longer than all else that is done for an option."""
    return docstring_parser.parse(text)


def help_of(subject: Any, name: str) -> str:
    """Description of a parameter or attribute, and its range."""
    words = in_words(hints_of(subject).get(name))
    return f"{_described(subject, name)} Range: {words}." if words else _described(subject, name)


def _described(subject: Any, name: str) -> str:
    """Description of a parameter or attribute in the docstring of a function or class, or of the class's bases."""
    for one in inspect.getmro(subject) if inspect.isclass(subject) else (subject,):
        for entry in docstring(one.__doc__ or "").params:
            if name in entry.arg_name.split(", "):  # "along, across: Offset from ..., m."
                return " ".join((entry.description or "").split())
    return ""
