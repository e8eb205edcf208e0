"""The command line in processes of their own, as a user starts it, without paying anew for each of them.

Each process is forked from one that has loaded the large libraries and nothing of ours, which saves it the seconds that
torch takes to load. What our own modules do in a fresh process is seen as ever.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

LIBRARIES = ("mujoco", "onnxruntime", "rich.progress", "rsl_rl.runners", "scipy.special", "tensordict", "torch", "tyro")
OUT, ERR = "stdout", "stderr"


class Ended(NamedTuple):
    """What a process leaves."""

    returncode: int
    stdout: str
    stderr: str


class Running:
    """A process. Its output goes into files, so that it never waits for a reader."""

    def __init__(self, process: ForkServerProcess, output: TemporaryDirectory[str]) -> None:
        self._process, self._output = process, output
        self._heard = 0  # lines of its standard output that were waited for

    @property
    def pid(self) -> int:
        assert self._process.pid is not None
        return self._process.pid

    def poll(self) -> int | None:
        """The exit code, or None while it runs."""
        return self._process.exitcode

    def send(self, number: signal.Signals) -> None:
        """Sends it a signal."""
        os.kill(self.pid, number)

    def wait_for(self, word: str, patience_s: float) -> str:
        """Waits for a line of its standard output, after those that were waited for before, that has the word.

        Raises:
            AssertionError: If it ends without such a line, or says none in time; it is ended then.
        """
        end, said = time.monotonic() + patience_s, Path(self._output.name, OUT)
        while True:
            ended = self.poll() is not None
            for line in said.read_text(encoding="utf-8").splitlines(keepends=True)[self._heard :]:
                if not line.endswith("\n"):
                    break
                self._heard += 1
                if word in line:
                    return line
            if ended or time.monotonic() > end:
                raise AssertionError(f"'{word}' was not said; {self.wait(0.0)}")
            time.sleep(0.02)

    def wait(self, patience_s: float | None = None) -> Ended:
        """Waits for its end, and kills it after `patience_s`."""
        self._process.join(patience_s)
        if self._process.exitcode is None:
            self._process.kill()
            self._process.join()
        assert self._process.exitcode is not None
        out, err = (Path(self._output.name, name).read_text(encoding="utf-8") for name in (OUT, ERR))
        return Ended(self._process.exitcode, out, err)


def start(
    *arguments: str,
    path: Sequence[Path] = (),
    env: Mapping[str, str] | None = None,
    prepare: Callable[[], object] | None = None,
) -> Running:
    """Starts `humoslope` with these arguments in the present working directory.

    Args:
        path: Folders in which modules are looked for before all others.
        env: Environment variables beside the present ones.
        prepare: Function of a module that is called in the process first.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(LIBRARIES))  # has an effect before the first process alone
    output = TemporaryDirectory(prefix="started-")
    for name in (OUT, ERR):
        Path(output.name, name).touch()
    variables = dict(os.environ) | dict(env or {})
    process = context.Process(target=_humoslope, args=(arguments, output.name, [*map(str, path)], variables, prepare))
    process.start()
    return Running(process, output)


def run(*arguments: str, path: Sequence[Path] = ()) -> Ended:
    """Runs `humoslope` with these arguments to its end."""
    return start(*arguments, path=path).wait()


def _humoslope(
    arguments: Sequence[str],
    output: str,
    path: list[str],
    variables: dict[str, str],
    prepare: Callable[[], object] | None,
) -> None:
    for descriptor, name in ((1, OUT), (2, ERR)):
        os.dup2(os.open(Path(output, name), os.O_WRONLY), descriptor)
    # As if started in the foreground: tests that run in the background would hand down an ignored SIGINT.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    os.environ.clear()
    os.environ.update(variables)
    sys.path[:0] = path
    sys.argv = ["humoslope", *arguments]
    if prepare is not None:
        prepare()
    from humoslope.cli import main

    sys.exit(main())
