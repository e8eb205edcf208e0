"""Command line, with one module for each verb."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from types import FrameType

from humoslope.errors import UserError, unknown

VERBS = {
    "train": "Train a task.",
    "list": "List the registered tasks and terrains.",
    "terrain": "Draw a terrain to a PNG.",
    "ramps": "Evaluate a checkpoint on flat ground and on ramps.",
    "evaluate": "Evaluate checkpoints on the held-out track.",
    "calibrate": "Fit the swing reference of Stage II to a Stage-I checkpoint.",
    "table": "Print the paper's tables beside the results of evaluations.",
    "figures": "Draw the results of evaluations.",
    "curve": "Draw the learning curve of a run.",
    "compare": "Compare training runs after equally many environment steps.",
    "record": "Record one walk of a checkpoint to a file.",
    "replay": "Show a recorded walk in rerun.",
    "video": "Make a video and a contact sheet of a recorded walk.",
    "meshes": "Fetch the real meshes of a robot, for replay and video.",
    "upgrade": "Rewrite a checkpoint of an older version in the format of this one.",
    "export": "Export a checkpoint to ONNX and a contract.",
    "play": "Run an exported policy in plain MuJoCo.",
    "deploy": "Run an exported policy on a robot, or on a simulated one.",
    "robot": "Simulate a robot for `humoslope deploy`, on the loopback interface.",
    "doctor": "Find out what is wrong from a walk that `humoslope deploy` recorded.",
    "margins": "Certify the physical conditions up to which an exported policy succeeds.",
    "bench": "Measure speed and memory.",
    "check": "Check that an installation is right and fast, on a GPU or a CPU.",
}
"""Each verb is `run(arguments)` in the module of its name."""


class Terminated(KeyboardInterrupt):
    """SIGTERM or SIGHUP. Whatever cleans up after Ctrl-C cleans up after them."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.exit_code = 128 + number


@contextmanager
def _signals_raised() -> Iterator[None]:
    """Turns SIGTERM and SIGHUP into `Terminated`, so that temporary files are removed and child processes ended."""
    if threading.current_thread() is not threading.main_thread():  # only there may handlers be set
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        raise Terminated(number)

    names = ("SIGTERM", "SIGHUP")  # Windows has no SIGHUP
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    # A signal that is ignored (nohup) stays so.
    handlers = {n: signal.signal(n, stop) for n in numbers if signal.getsignal(n) is not signal.SIG_IGN}
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def main(arguments: list[str] | None = None) -> int:
    """Runs a verb and returns its exit code: 2 for a mistake of the user, which is reported in one sentence."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if not arguments or arguments[0] in ("-h", "--help"):
        _print_help()
        return 0
    verb, rest = arguments[0], arguments[1:]
    code, said = 0, ""
    try:
        if verb not in VERBS:
            raise unknown("verb", verb, VERBS)
        run: Callable[[list[str]], None] = import_module(f"humoslope.cli.{verb}").run
        with _signals_raised():
            run(rest)
    except UserError as error:
        code, said = 2, str(error)
    except Terminated as stop:
        code, said = stop.exit_code, "terminated."
    except KeyboardInterrupt:
        code, said = 130, "interrupted."
    except BrokenPipeError:
        code = 1
    except RuntimeError as error:
        if type(error).__name__ != "OutOfMemoryError":  # torch's; not every verb loads torch
            raise
        code, said = 2, "the memory of the GPU is full; choose fewer envs with --env.num-envs."
    if said:
        print(f"humoslope: {said}", file=sys.stderr)
    return code


def _print_help() -> None:
    width = max(map(len, VERBS))
    print("humoslope VERB [...]; humoslope VERB --help lists its options.\n")
    for verb, line in VERBS.items():
        print(f"  {verb:<{width}}  {line}")
