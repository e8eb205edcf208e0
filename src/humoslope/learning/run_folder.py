"""The folder of a training run: claimed by one process, with a record of every start and everything it printed.

model_100.pt ...        checkpoints
episodes_100.pt         the state of all episodes at the newest one
events.out.tfevents...  curves
console.log             everything that was printed
starts/1/, starts/2/    for each start, options.txt, config.json, git.txt and start.json (what it began with), and their
                        checksums
"""

from __future__ import annotations

import fcntl
import json
import os
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, cast

from rich.console import Console

import humoslope
from humoslope.errors import UserError
from humoslope.files import check_place, remove_leftovers, write_text
from humoslope.provenance import git_state, plain
from humoslope.seal import check_sums, write_sums

if TYPE_CHECKING:
    from humoslope.registry import TaskCfg


LOGS = Path("logs")
"""Where runs lie that are given no other place."""
LOOKING = ("--watch", "--no-watch", "--watch-worlds", "--web-port", "--port", "--video-every")
"""Options that let somebody look on, change nothing in a training, and are not recorded."""


@contextmanager
def claimed(run_dir: Path | None, task: str, new: bool) -> Iterator[Path]:
    """Keeps a run folder for this process while inside, so that no second training writes into it.

    The lock is the operating system's, on the folder itself, and ends with the process, however that ends. Folders that
    were made here, and into which nothing was written, are removed again.

    Args:
        run_dir: The folder; None for a new one under logs/, named by the present second.
        new: Whether the folder must not hold a run yet.

    Raises:
        UserError: If another training has it, or a new run would write over an old one.
    """
    run_dir, made = _made(run_dir, task)
    handle = os.open(run_dir, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise UserError(f"run folder '{run_dir}' is in use by another training; choose another.") from None
        if new:
            _require_no_run(run_dir)
        for folder in (run_dir, run_dir / "diverged"):
            remove_leftovers(folder)
        yield run_dir
    finally:
        os.close(handle)
        for path in made:
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()


def _made(run_dir: Path | None, task: str) -> tuple[Path, list[Path]]:
    """The run folder, and the folders that were made for it, innermost first."""
    base = LOGS / task / datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    names = [run_dir] if run_dir is not None else [base, *(base.with_name(f"{base.name}_{n}") for n in range(2, 1000))]
    for path in names:
        check_place(path / "config.json")
        missing = [parent for parent in (path, *path.parents) if not parent.exists()]
        try:
            path.mkdir(parents=True, exist_ok=run_dir is not None)
        except FileExistsError:
            continue  # a run that began in the same second has it
        except OSError as error:
            raise UserError(f"run folder '{path}' cannot be made: {error.strerror}.") from None
        return path, missing
    raise UserError(f"there is no free name for a run folder at '{base}'.")


def record_start(
    run_dir: Path, task: str, cfg: TaskCfg, options: list[str], iteration: int, total_steps: int, origin: Path | None
) -> None:
    """Writes a record of this start: resolved configuration, options as typed, state of the code.

    Args:
        iteration, total_steps: What is done already.
        origin: The checkpoint that is resumed from or started from.
    """
    folder = run_dir / "starts" / str(len(starts(run_dir)) + 1)
    about = {
        "task": task,
        "version": humoslope.__version__,
        "time": datetime.now().astimezone().isoformat(timespec="seconds"),
        "iteration": iteration,
        "total_steps": total_steps,
        "from": None if origin is None else str(origin),
    }
    resolved = {"task": task, "env": plain(cfg.env), "agent": plain(cfg.agent)}
    files = {
        "config.json": json.dumps(resolved, indent=2),
        "options.txt": shlex.join(options),
        "git.txt": git_state(),
        "start.json": json.dumps(about, indent=2),
    }
    for name, text in files.items():
        write_text(folder / name, text)
    write_sums(folder, files)


def starts(run_dir: Path) -> list[Path]:
    """The records of a run's starts, oldest first."""
    found = [path for path in (run_dir / "starts").glob("*") if path.name.isdigit()]
    return sorted(found, key=lambda path: int(path.name))


def start_of(run_dir: Path) -> dict[str, Any] | None:
    """What a run began with: its "task", and "from" which checkpoint, or None; None if the folder does not say."""
    first = starts(run_dir)[:1]
    return _read(first[0] / "start.json") if first else None


def saved_options(run_dir: Path, total_steps: float = float("inf")) -> list[str]:
    """The options that held in a run when it had seen `total_steps` environment steps; none if the folder does not say.

    Options accumulate: a resumed run keeps those of its earlier starts unless they were given anew.

    Raises:
        UserError: If a record cannot be read, or is damaged.
    """
    options: list[str] = []
    old = run_dir / "options.txt"  # runs of earlier versions kept the last start alone
    if old.is_file():
        options += _words(old)
    for folder in starts(run_dir):
        check_sums(folder, "or")
        about = _read(folder / "start.json")
        if about is not None and about["total_steps"] < total_steps:
            options += _words(folder / "options.txt")
    return options


def _words(path: Path) -> list[str]:
    try:
        return shlex.split(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UserError(f"the options in '{path}' cannot be read: {error}.") from None


def find_run(task: str, which: str) -> Path:
    """The run folder `which`, or the newest of the task for "latest".

    Raises:
        UserError: If there is none.
    """
    if which != "latest":
        path = Path(which)
        if path.is_file():
            raise UserError(
                f"'{path}' is a file; --resume takes the folder of a run, whose newest checkpoint goes on. A new run "
                "takes its actor from an older one with --init."
            )
        if not path.is_dir():
            raise UserError(f"run folder '{path}' does not exist.")
        return path
    runs = runs_of(task)
    if not runs:
        raise UserError(f"there is no run of {task} with a checkpoint under {LOGS}.")
    return runs[-1]


def runs_of(task: str) -> list[Path]:
    """The run folders of a task that hold a checkpoint, in logs/TASK/ or, as --run-dir may have it, in logs/; the one
    that was begun last is the last."""
    begun = {}
    for path in (*(LOGS / task).glob("*"), *LOGS.glob("*")):
        if any(path.glob("model_*.pt")):
            about = start_of(path) or {}
            if path.parent.name == task or about.get("task") == task:
                begun[path] = about.get("time", path.name)
    return sorted(begun, key=lambda path: (begun[path], path.name))


class _Both:
    """Writes to the terminal and to a file, which is opened only when there is something to write."""

    def __init__(self, terminal: IO[str] | None, path: Path) -> None:
        self._terminal, self._path = terminal, path
        self._file: IO[str] | None = None
        self._is_full = False  # the disk, or whatever else keeps the file from being written

    def write(self, text: str) -> int:
        self._write_file(text)
        self._with_terminal(lambda terminal: terminal.write(text))
        return len(text)

    def flush(self) -> None:
        self._with_terminal(lambda terminal: terminal.flush())  # the file is written line by line

    def _write_file(self, text: str) -> None:
        if self._is_full:
            return
        try:
            if self._file is not None and not self._path.exists():  # the folder was removed
                self._file.close()
                self._file = None
            if self._file is None:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                self._file = self._path.open("a", encoding="utf-8", buffering=1)  # a full disk shows at once
            self._file.write(text)
        except OSError as error:
            self._is_full = True
            with suppress(OSError):  # closing writes what is left
                if self._file is not None:
                    self._file.close()
            self._file = None
            said = f"{self._path} cannot be written ({error.strerror}); training goes on without it.\n"
            self._with_terminal(lambda terminal: terminal.write(said))

    def _with_terminal(self, act: Callable[[IO[str]], object]) -> None:
        """Writes to the terminal as long as there is one: a pipe that was closed is no reason to end a training."""
        if self._terminal is None:
            return
        try:
            act(self._terminal)
        except OSError as error:
            self._terminal = None
            self._write_file(f"The terminal is gone ({error.strerror}); training goes on, and this file tells how.\n")

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
        is_terminal = sys.stdout is not None and sys.stdout.isatty()
        yield Console(file=cast("IO[str]", both), width=None if is_terminal else 140)
    finally:
        both.close()


def _require_no_run(run_dir: Path) -> None:
    """Raises UserError unless a new run can be put there."""
    if any(run_dir.glob("model_*.pt")):
        raise UserError(
            f"run folder '{run_dir}' holds a run already; resume it with --resume {run_dir}, or choose another."
        )
    if any((run_dir / name).exists() for name in ("config.json", "console.log", "starts")):
        raise UserError(f"run folder '{run_dir}' holds a run that left no checkpoint; remove it, or choose another.")


def _read(path: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) and isinstance(content.get("total_steps"), int) else None
