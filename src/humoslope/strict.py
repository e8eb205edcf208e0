"""Configurations without room for mistyped fields."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from humoslope.errors import unknown


class StrictCfg:
    """Base of configuration dataclasses in which only declared fields can be assigned.

    Raises:
        UserError: At the assignment of another name, with the nearest match.
    """

    def __setattr__(self, name: str, value: Any) -> None:
        names = [field.name for field in fields(self)]  # type: ignore[arg-type]
        if name not in names:
            raise unknown(f"{type(self).__name__} field", name, names)
        super().__setattr__(name, value)
