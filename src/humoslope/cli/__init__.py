"""Command line, with one module for each verb."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module

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
    "bench": "Measure speed and memory.",
    "check": "Check that an installation is right and fast, on a GPU or a CPU.",
}
"""Each verb is `run(arguments)` in the module of its name."""


def main(arguments: list[str] | None = None) -> int:
    """Runs a verb and returns its exit code: 2 for a mistake of the user, which is reported in one sentence."""
    arguments = sys.argv[1:] if arguments is None else arguments
    if not arguments or arguments[0] in ("-h", "--help"):
        _print_help()
        return 0
    verb, rest = arguments[0], arguments[1:]
    try:
        if verb not in VERBS:
            raise unknown("verb", verb, VERBS)
        run: Callable[[list[str]], None] = import_module(f"humoslope.cli.{verb}").run
        run(rest)
    except UserError as error:
        print(f"humoslope: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("humoslope: interrupted.", file=sys.stderr)
        return 130
    except BrokenPipeError:
        return 1
    return 0


def _print_help() -> None:
    width = max(map(len, VERBS))
    print("humoslope VERB [...]; humoslope VERB --help lists its options.\n")
    for verb, line in VERBS.items():
        print(f"  {verb:<{width}}  {line}")
