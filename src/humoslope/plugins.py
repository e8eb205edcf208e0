"""Folders in which every file registers something."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from pkgutil import iter_modules


def import_all(package: str, path: Iterable[str]) -> None:
    """Imports every module of a package, so that a new file in its folder is enough to register what is in it.

    Args:
        package: The package's `__name__`.
        path: Its `__path__`.
    """
    for module in iter_modules(path):
        import_module(f"{package}.{module.name}")
