"""Origin of a result: configurations as plain data, and the state of the code."""

from __future__ import annotations

import dataclasses
import subprocess
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import humoslope
from humoslope import shipped
from humoslope.managers.terms import Terms


def plain(value: Any) -> Any:
    """A configuration as JSON types; functions become their qualified names."""
    if isinstance(value, Terms):
        return {name: plain(term) for name, term in value.items()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, tuple | list):
        return [plain(v) for v in value]
    if callable(value):
        return f"{value.__module__}.{value.__qualname__}"
    return str(value) if isinstance(value, Path) else value


@lru_cache(maxsize=1)
def commit() -> str:
    """Commit of the code that this process runs, such as "commit 1a2b3c..."."""
    return git_state().splitlines()[0]


def git_state() -> str:
    """Commit, changed files and differences of the checkout, as far as git knows; of a wheel, the commit it is of."""
    root = Path(humoslope.__file__).parent
    built_from = shipped.root() / "commit.txt"
    if built_from.is_file():  # git would tell of the repository that the environment happens to lie in
        return built_from.read_text(encoding="utf-8")

    def git(*words: str) -> str:
        try:
            done = subprocess.run(["git", *words], cwd=root, capture_output=True, text=True, timeout=20, check=False)
        except (OSError, subprocess.TimeoutExpired):
            return ""
        return done.stdout

    return f"commit {git('rev-parse', 'HEAD')}\n{git('status', '--short')}\n{git('diff', 'HEAD')}"
