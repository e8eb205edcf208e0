"""Flipped bits, truncations and wiped ranges in every kind of file that is written: each is noticed."""

from __future__ import annotations

import contextlib
import io
import random
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from humoslope.deploy import contract
from humoslope.errors import UserError
from humoslope.evaluation.report.curve import read_table
from humoslope.evaluation.report.results import read_results
from humoslope.evaluation.swing.file import load_calibration
from humoslope.learning import checkpoint
from humoslope.learning.run_folder import saved_options
from humoslope.replay.rollout import load_rollout
from humoslope.seal import beside, read_arrays, read_json
from tests.drills.report import Drill

FORBIDDEN = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "socket.connect", "pty.spawn")
"""Events of Python's audit that no file may cause."""

Reader = Callable[[Path], object]
READERS: dict[str, Reader] = {
    "checkpoint": checkpoint.load,
    "episodes": checkpoint.load_sealed,
    "rollout": load_rollout,
    "result": lambda path: read_results([str(path)]),
    "calibration": load_calibration,
    "saved trials": read_arrays,
    "saved margins": read_json,
    "curve": read_table,
    "start": saved_options,
    "export": contract.read,
}
"""What reads each kind of file or folder."""
WALKED_ANEW = ("saved trials", "saved margins")
"""Kinds for which an error of their reader means that they are walked anew, with a word."""
FILES_OF_FOLDERS = 8
"""Files in the folders, beyond the one that each kind counts for."""


def spoil(content: bytes, rng: random.Random) -> bytes:
    """Other content: one to eight bits flipped, the end cut off, or a range wiped."""
    damaged = bytearray(content)
    kind = rng.choice(("flip", "flip", "cut", "wipe"))
    if kind == "flip":
        for _ in range(rng.choice((1, 1, 1, 8))):
            damaged[rng.randrange(len(damaged))] ^= 1 << rng.randrange(8)
    elif kind == "cut":
        del damaged[rng.choice((rng.randrange(len(damaged)), len(damaged) - rng.randrange(1, min(99, len(damaged))))) :]
    else:
        start = rng.randrange(len(damaged))
        length = rng.randrange(1, 1 + min(4096, len(damaged) - start))
        damaged[start : start + length] = bytes(length)
    return bytes(damaged)


def drill_kind(kind: str, whole: Path, scratch: Path, count: int, seed: int = 0) -> Drill:
    """Damages a copy of a file, or each file in a copy of a folder, `count` times, and reads it; nothing in it may be
    executed."""
    result, read, rng = Drill(f"damage: {kind}"), READERS[kind], random.Random(seed)
    scratch.mkdir(parents=True, exist_ok=True)
    copy = scratch / whole.name
    if whole.is_dir():
        shutil.copytree(whole, copy)
    else:
        shutil.copy(whole, copy)
        for listed in whole.parent.glob(beside(whole)):
            shutil.copy(listed, scratch)
    read(copy)
    files = sorted(path for path in copy.rglob("*") if path.is_file()) if copy.is_dir() else [copy]
    with watched_execution() as executed:
        for path in files:
            content = path.read_bytes()
            for _ in range(count):
                damaged = spoil(content, rng)
                if damaged != content:
                    path.write_bytes(damaged)
                    _judge(result, kind, lambda: read(copy))
            path.write_bytes(content)
    read(copy)
    result.failures += [f"executed: {event}" for event in executed]
    return result


def _judge(result: Drill, kind: str, read: Callable[[], object]) -> None:
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            read()
    except UserError as error:
        sentence = str(error)
        result.add("refused", "" if "\n" not in sentence else f"said: {sentence}")
    except (ValueError, OSError, KeyError) as error:
        allowed = kind in WALKED_ANEW
        result.add("walked anew" if allowed else "traceback", "" if allowed else repr(error))
    except Exception as error:
        result.add("traceback", repr(error))
    else:
        result.add("accepted", "a damaged file was read without a word")


@contextlib.contextmanager
def watched_execution() -> Iterator[list[str]]:
    """A list to which every forbidden event of this process is added while inside."""
    seen: list[str] = []
    watching = [True]
    sys.addaudithook(lambda event, arguments: seen.append(event) if watching and event in FORBIDDEN else None)
    try:
        yield seen
    finally:
        watching.clear()
