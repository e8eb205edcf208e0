"""Flipped bits, truncations and wiped ranges in every kind of file that is written: each is noticed."""

from __future__ import annotations

import contextlib
import io
import random
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

from humoslope.deploy import contract
from humoslope.errors import UserError
from humoslope.evaluation.report.results import read_results
from humoslope.evaluation.swing.file import load_calibration
from humoslope.learning import checkpoint
from humoslope.replay.rollout import load_rollout
from humoslope.seal import SUMS, read_arrays, read_json
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
}
"""What reads each kind of file; what reads saved trials takes an error for "walk them anew"."""


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


def drill_file(kind: str, path: Path, folder: Path, count: int, seed: int = 0) -> Drill:
    """Damages a copy of a file `count` times and reads it."""
    read, rng, content = READERS[kind], random.Random(seed), path.read_bytes()
    result, copy = Drill(f"damage: {kind}"), folder / path.name
    copy.write_bytes(content)
    read(copy)  # whole
    for _ in range(count):
        damaged = spoil(content, rng)
        if damaged != content:
            copy.write_bytes(damaged)
            _judge(result, lambda: read(copy))
    return result


def drill_export(folder: Path, scratch: Path, count: int, seed: int = 0) -> Drill:
    """Damages each file of a copy of an export `count` times and reads the export."""
    copy = shutil.copytree(folder, scratch / "export")
    contract.read(copy)
    result, rng = Drill("damage: export"), random.Random(seed)
    files = [path for path in sorted(copy.rglob("*")) if path.is_file()]
    assert copy / SUMS in files
    for path in files:
        content = path.read_bytes()
        for _ in range(count):
            damaged = spoil(content, rng)
            if damaged != content:
                path.write_bytes(damaged)
                _judge(result, lambda: contract.read(copy))
        path.write_bytes(content)
    contract.read(copy)
    return result


def _judge(result: Drill, read: Callable[[], object]) -> None:
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            read()
    except UserError as error:
        sentence = str(error)
        result.add("refused", "" if "\n" not in sentence else f"said: {sentence}")
    except (ValueError, OSError, KeyError) as error:
        allowed = result.name in ("damage: saved trials", "damage: saved margins")
        result.add("walked anew" if allowed else "traceback", "" if allowed else repr(error))
    except Exception as error:
        result.add("traceback", repr(error))
    else:
        result.add("accepted", "a damaged file was read without a word")


def watch_for_execution() -> list[str]:
    """A list to which every forbidden event of this process is added from now on."""
    seen: list[str] = []
    sys.addaudithook(lambda event, arguments: seen.append(event) if event in FORBIDDEN else None)
    return seen
