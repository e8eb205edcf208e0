"""Configurations that refuse a mistyped field."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from humoslope.errors import unknown


class StrictCfg:
    """Base of configuration dataclasses:
    assigning to a field that does not exist is an error, with the nearest match."""

    def __setattr__(self, name: str, value: Any) -> None:
        names = [field.name for field in fields(self)]  # type: ignore[arg-type]
        if name not in names:
            raise unknown(f"{type(self).__name__} field", name, names)
        super().__setattr__(name, value)
