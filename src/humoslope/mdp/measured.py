"""What an observation is in the words of an exported policy's contract, so that a robot can measure it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])


def measured_as(quantity: str) -> Callable[[F], F]:
    """Declares which quantity of `humoslope.play.quantities` an observation function returns.

    An actor can be exported only if each of its observations says so.
    """

    def declare(func: F) -> F:
        func.measured_quantity = quantity  # type: ignore[attr-defined]
        return func

    return declare
