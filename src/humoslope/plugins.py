"""Packages in which every module registers something."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from pkgutil import iter_modules


def import_all(package: str, path: Iterable[str]) -> None:
    """Imports every module of a package, so that its content is registered by the mere presence of a file.

    Args:
        package: `__name__` of the package.
        path: `__path__` of the package.
    """
    for module in iter_modules(path):
        import_module(f"{package}.{module.name}")
