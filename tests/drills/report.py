"""What a drill found, and the results that are kept so that an interrupted `make drills` goes on where it was."""

from __future__ import annotations

import dataclasses
import hashlib
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from humoslope.seal import read_json, write_json

SOURCES = ("src", "robots", "tasks", "terrains", "tests/drills")
"""Folders of all code that a result depends on."""


@dataclass
class Drill:
    """A drill: so many faults were injected, and these were not borne as they must be.

    Attributes:
        name: What was done.
        tried: Number of faults.
        failures: A line for each that was not borne.
        seen: How often each answer was seen.
        seconds: Time that it took, s, on the machine as busy as it was.
    """

    name: str
    tried: int = 0
    failures: list[str] = field(default_factory=list)
    seen: dict[str, int] = field(default_factory=dict)
    seconds: float = 0.0

    def add(self, answer: str, failure: str = "") -> None:
        """Counts a fault and its answer; a text in `failure` says how the answer was wrong."""
        self.tried += 1
        self.seen[answer] = self.seen.get(answer, 0) + 1
        if failure:
            self.failures.append(failure)

    def join(self, other: Drill) -> None:
        """Adds what another part of the same drill found."""
        self.tried += other.tried
        self.seconds += other.seconds
        self.failures += other.failures
        for answer, count in other.seen.items():
            self.seen[answer] = self.seen.get(answer, 0) + count


@dataclass(frozen=True)
class Part:
    """A part of a drill that is done in one go.

    Attributes:
        drill: Name of the drill.
        which: Name of the part, which with the drill's decides what is done.
        work: Does it.
    """

    drill: str
    which: str
    work: Callable[[], Drill]


class Kept:
    """Results of parts in a folder, one file each; those of other code are not found."""

    def __init__(self, folder: Path, code: str) -> None:
        self._folder, self._code = folder, code

    def get(self, part: Part) -> Drill | None:
        """The result of a part that was finished before; None if there is none, or it is damaged."""
        try:
            return Drill(**read_json(self._path(part)))
        except (OSError, ValueError, TypeError):
            return None

    def run(self, part: Part) -> Drill:
        """Does a part and keeps its result."""
        started = time.monotonic()
        result = part.work()
        result.name, result.seconds = part.drill, time.monotonic() - started
        write_json(self._path(part), dataclasses.asdict(result))
        return result

    def _path(self, part: Part) -> Path:
        words = "-".join(f"{part.drill} {part.which}".replace(":", "").replace(",", "").split())
        return self._folder / self._code / f"{words}.json"


def hash_of_code(folders: Iterable[str] = SOURCES) -> str:
    """Twelve digits that change with any Python file in these folders."""
    files = sorted(path for folder in folders for path in Path(folder).rglob("*.py"))
    return hashlib.sha256(b"".join(str(path).encode() + path.read_bytes() for path in files)).hexdigest()[:12]


def joined(parts: Iterable[Drill]) -> list[Drill]:
    """The drills that the results of their parts make, in their order."""
    found: dict[str, Drill] = {}
    for part in parts:
        found.setdefault(part.name, Drill(part.name)).join(part)
    return list(found.values())
