"""Packages that only some verbs need, and what to say where they are not installed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from humoslope.errors import UserError

MATPLOTLIB = "matplotlib"
EXTRAS = {
    "embreex": "view",
    "imageio_ffmpeg": "view",
    MATPLOTLIB: "view",
    "mjviser": "view",
    "onnx": "export",
    "onnxscript": "export",
    "rerun": "view",
    "rerun_cli": "view",
    "trimesh": "view",
    "unitree_interface": "robot",
    "viser": "view",
    "wandb": "wandb",
    "yourdfpy": "view",
}
"""The extra of pyproject.toml that brings each package, by the name that it is imported by."""


def installed(package: str) -> bool:
    """True if a package can be imported; it is not imported for that."""
    try:
        return find_spec(package) is not None
    except ImportError:
        return False


def require(who: str, package: str) -> None:
    """Checks, before the work that needs it, that a package is installed.

    Args:
        who: What needs it, the beginning of the sentence.
        package: Name that it is imported by, one of `EXTRAS`.

    Raises:
        UserError: If it is not.
    """
    if not installed(package):
        raise UserError(missing(who, package))


def missing(who: str, package: str) -> str:
    """The sentence for a package that is not installed, with the command that installs it."""
    return f"{who} needs the package {package}, which is not installed: pip install 'humoslope[{EXTRAS[package]}]'."


@contextmanager
def explained_extras(who: str) -> Iterator[None]:
    """Says in one sentence, with the command that installs it, which of these packages an import inside did not find.

    Args:
        who: What needs it, the beginning of the sentence.

    Raises:
        UserError: In place of the import's own error.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in EXTRAS:
            raise
        raise UserError(missing(who, package)) from None
