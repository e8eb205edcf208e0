"""What a user did wrong, said in one sentence."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable

LISTED = 20
"""Names that a message lists at most."""


class UserError(Exception):
    """A mistake the user can put right. The command line prints its message alone and exits with code 2."""


def unknown(kind: str, name: str, known: Iterable[str]) -> UserError:
    """The error for a name that is not in a registry or config, with the nearest match.

    Args:
        kind: What was looked for, such as "task" or "terrain".
        name: What the user wrote.
        known: What there was to choose from.
    """
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.4)
    more = f", ... ({len(names) - LISTED} more)" if len(names) > LISTED else ""
    listed = ", ".join(names[:LISTED]) or "none"
    hint = f"did you mean '{near[0]}'?" if near else f"there are: {listed}{more}."
    return UserError(f"{kind} '{name}' does not exist; {hint}")


def require_positive(who: str, **values: float) -> None:
    """Raises a `UserError` that names the first value of `who` that is not a positive number."""
    for name, value in values.items():
        if not 0.0 < value < math.inf:
            raise UserError(f"{who}: {name} is {value:g}; it must be positive.")


def require_not_negative(who: str, **values: float) -> None:
    """Raises a `UserError` that names the first value of `who` that is not a number from zero up."""
    for name, value in values.items():
        if not 0.0 <= value < math.inf:
            raise UserError(f"{who}: {name} is {value:g}; it must be 0 or more.")
