"""The folder of a training run: what was run, with which code, and everything it printed."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, cast

from rich.console import Console

import humoslope
from humoslope.errors import UserError
from humoslope.files import write_text
from humoslope.provenance import git_state, plain

if TYPE_CHECKING:
    from humoslope.registry import TaskCfg


def describe_run(run_dir: Path, task: str, cfg: TaskCfg, options: list[str]) -> None:
    """Writes the resolved configuration, the options and the state of the code."""
    resolved = {"task": task, "version": humoslope.__version__, "env": plain(cfg.env), "agent": plain(cfg.agent)}
    write_text(run_dir / "config.json", json.dumps(resolved, indent=2))
    write_text(run_dir / "options.txt", shlex.join(options))
    write_text(run_dir / "git.txt", git_state())


def find_run(task: str, which: str) -> Path:
    """The run folder `which`, or the newest of the task for "latest".

    Raises:
        UserError: If there is none.
    """
    if which != "latest":
        path = Path(which)
        if not path.is_dir():
            raise UserError(f"run folder '{path}' does not exist.")
        return path
    runs = runs_of(task)
    if not runs:
        raise UserError(f"there is no run of {task} with a checkpoint under {Path('logs') / task}.")
    return runs[-1]


def runs_of(task: str) -> list[Path]:
    """The run folders of a task under logs/ that hold a checkpoint, newest last."""
    return sorted(p for p in (Path("logs") / task).glob("*") if any(p.glob("model_*.pt")))


class _Both:
    """Writes to the terminal and to a file, which is opened only when there is something to write."""

    def __init__(self, terminal: IO[str], path: Path) -> None:
        self._terminal, self._path = terminal, path
        self._file: IO[str] | None = None

    def write(self, text: str) -> int:
        if self._file is None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self._path.open("a", encoding="utf-8")
        self._file.write(text)
        return self._terminal.write(text)

    def flush(self) -> None:
        self._terminal.flush()
        if self._file is not None:
            self._file.flush()

    def close(self) -> None:
        if self._file is not None:
            self._file.close()


@contextmanager
def tee(path: Path | None) -> Iterator[Console]:
    """A console that also writes to `path`; quiet if there is none (the other processes of a distributed run)."""
    if path is None:
        yield Console(quiet=True)
        return
    both = _Both(sys.stdout, path)
    try:
        yield Console(file=cast("IO[str]", both), width=None if sys.stdout.isatty() else 140)
    finally:
        both.close()
