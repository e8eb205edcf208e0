"""Mistakes of the user, each reported in one sentence."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable

LISTED = 20
"""Largest number of names that a message lists."""


class UserError(Exception):
    """User error with a message of one sentence, which the command line prints alone before it exits with code 2.

    A message is one line of a length that can be read, whatever was typed: characters that are not printed are written
    as in Python's texts, and quoted words of more than 300 characters are cut.
    """

    def __str__(self) -> str:
        line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in super().__str__())
        return re.sub(r"'([^']{60})[^']{240,}'", r"'\1...'", line)


def unknown(kind: str, name: str, known: Iterable[str]) -> UserError:
    """Error for a name that is not in a registry or configuration, with the nearest match.

    Args:
        kind: Kind of thing that was looked for, such as "task" or "terrain".
        name: Name as the user wrote it.
        known: Names that exist.
    """
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.4)
    more = f", ... ({len(names) - LISTED} more)" if len(names) > LISTED else ""
    listed = ", ".join(names[:LISTED]) or "none"
    hint = f"did you mean '{near[0]}'?" if near else f"there are: {listed}{more}."
    return UserError(f"{kind} '{name}' does not exist; {hint}")


def require_positive(who: str, **values: float) -> None:
    """Raises a UserError for the first value that is not a positive number; `who` begins the message."""
    for name, value in values.items():
        if not 0.0 < value < math.inf:
            raise UserError(f"{who}: {name} is {value:g}; it must be positive ({_wrong(value)}).")


def require_not_negative(who: str, **values: float) -> None:
    """Raises a UserError for the first value that is not a number of at least zero; `who` begins the message."""
    for name, value in values.items():
        if not 0.0 <= value < math.inf:
            raise UserError(f"{who}: {name} is {value:g}; it must be 0 or more ({_wrong(value)}).")


def _wrong(value: float) -> str:
    return "too low" if math.isfinite(value) else "not finite"
