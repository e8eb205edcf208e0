"""Writing of files so that a crash never leaves half of one."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from humoslope.errors import UserError


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Writes a file in one step: `write` fills a temporary file beside it, which then replaces it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.chmod(0o644)
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def check_place(path: Path) -> None:
    """Checks, before the work whose result it is for, that a file can be written; creates nothing.

    Raises:
        UserError: If `path` is a folder, or its folder can neither be created nor written to.
    """
    if path.is_dir():
        raise UserError(f"'{path}' is a folder; name a file in it.")
    existing = next(p for p in path.absolute().parents if p.exists())
    if not existing.is_dir() or not os.access(existing, os.W_OK):
        raise UserError(f"cannot write '{path}': '{existing}' is no folder one can write to.")


def write_text(path: Path, text: str) -> None:
    """Writes a text file in one step."""
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
