"""Command line, with one module for each verb."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from importlib import import_module
from types import FrameType
from typing import Any, TextIO, cast

import humoslope
from humoslope.errors import UserError, unknown
from humoslope.extras import explained_extras
from humoslope.interrupts import Terminated, handled

VERBS = {
    "demo": "Show the shipped policy on a slope, live and steerable.",
    "train": "Train a task.",
    "campaign": "Run a table of trainings and evaluations.",
    "list": "List the registered tasks and terrains, and the shipped files.",
    "terrain": "Draw a terrain to a PNG.",
    "ramps": "Evaluate a checkpoint on flat ground and on ramps.",
    "evaluate": "Evaluate checkpoints on the held-out track.",
    "calibrate": "Fit the swing reference of Stage II to a Stage-I checkpoint.",
    "table": "Print the paper's tables beside the results of evaluations.",
    "figures": "Draw the results of evaluations.",
    "dashboard": "Show the curves of a training in the terminal.",
    "curve": "Draw the learning curve of a run.",
    "report": "Write one HTML page of a run or of a comparison.",
    "compare": "Compare training runs after equally many environment steps.",
    "record": "Record one walk of a checkpoint to a file.",
    "replay": "Show a recorded walk in rerun.",
    "video": "Make a video and a contact sheet of a recorded walk.",
    "meshes": "Fetch the real meshes of a robot, for replay and video.",
    "upgrade": "Rewrite a checkpoint of an older version in the format of this one.",
    "export": "Export a checkpoint to ONNX and a contract.",
    "import": "Make an export of a policy that was trained elsewhere.",
    "play": "Run an exported policy in plain MuJoCo.",
    "deploy": "Run an exported policy on a robot, or on a simulated one.",
    "robot": "Simulate a robot for `humoslope deploy`, on the loopback interface.",
    "doctor": "Find out what is wrong from a walk that `humoslope deploy` recorded.",
    "margins": "Certify the physical conditions up to which an exported policy succeeds.",
    "accept": "Check whether an exported policy meets what is demanded of one that is to walk on a robot.",
    "bench": "Measure speed and memory.",
    "check": "Check that an installation is right and fast, on a GPU or a CPU.",
}
"""Each verb is `run(arguments)` in the module of its name."""


PRINTING = ("list", "table", "compare", "doctor")
"""Verbs whose result is what they print. They end when nobody reads it any more; others finish their work."""
HELP = ("-h", "--help")
VERSION = "--version"
EXIT_CODES = """Exit codes: 0 complete; 2 a mistake, said in one sentence; 130, 143, 129 stopped by Ctrl-C, SIGTERM or
SIGHUP, with what was done kept; 141 nobody reads the output any more; 1 an error of the program, with a traceback, or
something that `check` or `accept` finds wrong. Under torchrun each process has these codes, torchrun itself 0 or 1."""


def main(arguments: list[str] | None = None) -> int:
    """Runs a verb and returns its exit code, see `EXIT_CODES`."""
    arguments = sys.argv[1:] if arguments is None else arguments
    _say_all_characters()
    code, said, unread = 0, "", 141
    try:
        verb, rest = (arguments or ["--help"])[0], arguments[1:]
        if verb not in (*VERBS, *HELP, VERSION):
            raise unknown("verb", verb, VERBS)
        prints_only = verb in (*PRINTING, *HELP, VERSION) or not {*rest}.isdisjoint(HELP)
        unread = 141 if prints_only else 0
        # A training sees to its terminal itself.
        reading = nullcontext() if prints_only or verb == "train" else _without_readers()
        with handled(_stop), explained_extras(verb), reading:
            run: Callable[[list[str]], None] = (
                _verb(verb) if verb in VERBS else _print_version if verb == VERSION else _print_help
            )
            run(rest)
    except UserError as error:
        code, said = 2, str(error)
    except Terminated as stop:
        code, said = stop.exit_code, "interrupted." if stop.exit_code == 130 else "terminated."
    except KeyboardInterrupt:
        code, said = 130, "interrupted."
    except BrokenPipeError:
        code = 141
    except SystemExit as stop:  # rich makes one of a closed pipe
        if _said("") and not isinstance(stop.__context__, BrokenPipeError):
            raise
        code = unread or int(stop.code or 0)
    except (MemoryError, RuntimeError) as error:
        code, said = 2, _said_of_memory(error)
        if not said:
            raise
    except OSError as error:
        if error.strerror is None:
            raise
        code, said = 2, f"{error.strerror}{'' if error.filename is None else f': {error.filename}'}."
    return code if _said(said) or code else unread


def _verb(name: str) -> Callable[[list[str]], None]:
    run: Callable[[list[str]], None] = import_module(f"humoslope.cli.{name}").run
    return run


class _Unread:
    """A stream whose reader may go away: what is written from then on is lost."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with suppress(BrokenPipeError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(BrokenPipeError):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def _without_readers() -> Iterator[None]:
    """Lets the work inside go on when nobody reads what it prints any more."""
    before = sys.stdout
    if before is not None:
        sys.stdout = cast("TextIO", _Unread(before))
    try:
        yield
    finally:
        sys.stdout = before


def _stop(number: int, frame: FrameType | None) -> None:
    raise Terminated(number)


def _say_all_characters() -> None:
    """Lets a terminal that lacks a character show another one instead of ending the work."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")


def _said(sentence: str) -> bool:
    """Prints a last sentence, and what is still to be printed; False if nobody reads it any more."""
    read = True
    for stream, text in ((sys.stdout, ""), (sys.stderr, f"humoslope: {sentence}\n" if sentence else "")):
        try:
            if stream is not None:
                stream.write(text)
                stream.flush()
        except OSError:
            # Python would try again when it ends, and complain.
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
            read = False
    return read


def _said_of_memory(error: Exception) -> str:
    """A sentence for the user if memory has run out, else ""."""
    if type(error).__name__ == "OutOfMemoryError":  # torch's; not every verb loads torch
        return "the memory of the GPU is full; choose fewer envs with --env.num-envs."
    if isinstance(error, MemoryError) or "can't allocate memory" in str(error) or "bad_alloc" in str(error):
        return "the memory of this machine is full; choose fewer envs or smaller values."
    return ""


def _print_version(_: list[str]) -> None:
    print(f"humoslope {humoslope.__version__}")


def _print_help(_: list[str]) -> None:
    width = max(map(len, VERBS))
    print("humoslope VERB [...]; humoslope VERB --help lists its options.\n")
    for verb, line in VERBS.items():
        print(f"  {verb:<{width}}  {line}")
    print(f"\n{EXIT_CODES}")
