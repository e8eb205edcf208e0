"""`make drills`: the long versions of the drills, as a table; exit code 1 if one failed.

Finished parts are kept, so that the same command goes on after an interruption, and repeats nothing but what the code
has changed since. ARGS="--options 100" is shorter. The suite keeps short versions in `test_drills.py`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import torch
import tyro
from rich.console import Console
from rich.table import Table

from humoslope.cli import main
from humoslope.registry import load_content
from tests.drills import damage, options, processes
from tests.drills.files import KINDS, Made
from tests.drills.report import Drill, Kept, Part, hash_of_code, joined

SHIPPED = Path("experiments/checkpoints/stage1.pt")
SECONDS = {"kills": 2.0, "signals": 2.5, "rooms": 3.0, "options": 0.45, "flips": 0.03}
"""Time that one fault of each drill takes on an idle core, s, as measured; for a word on how long it will take."""
KILLS_OF_A_RUN = 5
PIECE = 50
"""Values of options that are one part."""


@dataclasses.dataclass(frozen=True)
class Long:
    """Numbers of faults.

    Attributes:
        kills: SIGKILLs, five of each run.
        signals: Runs that are stopped by INT, TERM or HUP.
        rooms: Runs without room for a file.
        options: Values of options.
        flips: Damages of each kind of file, and of each file of an export.
        seed: Seed of all random choices.
        keep: Folder for the results of finished parts.
        fresh: Do everything again.
    """

    kills: int = 20
    signals: int = 9
    rooms: int = 4
    options: int = 2000
    flips: int = 200
    seed: int = 0
    keep: Path = Path("logs/drills")
    fresh: bool = False


def parts(numbers: Long, made: Made, scratch: Path) -> Iterator[Part]:
    """All parts of all drills. Processes come first: they are forked, which threads of later ones would not survive."""
    seed, flips = numbers.seed, numbers.flips
    for first in range(0, numbers.kills, KILLS_OF_A_RUN):
        count = min(KILLS_OF_A_RUN, numbers.kills - first)
        yield Part(
            processes.KILLS,
            f"{first} {count} seed {seed}",
            lambda first=first, count=count: processes.drill_kills(  # type: ignore[misc]
                scratch / f"kills_{first}", count, seed + first, last=4 * count
            ),
        )
    for i in range(numbers.signals):
        yield Part(processes.SIGNALS, str(i), lambda i=i: processes.drill_signal(scratch, i))  # type: ignore[misc]
    for i in range(numbers.rooms):
        yield Part(processes.ROOMS, str(i), lambda i=i: processes.drill_room(scratch, i))  # type: ignore[misc]
    for kind in KINDS if flips else ():
        yield Part(
            f"damage: {kind}",
            f"{flips} seed {seed}",
            lambda kind=kind: damage.drill_kind(kind, made(kind), scratch / kind, flips, seed),  # type: ignore[misc]
        )
    for first in range(0, numbers.options, PIECE):
        last = min(first + PIECE, numbers.options)
        yield Part(
            "options",
            f"{first} {last} seed {seed}",
            lambda first=first, last=last: options.drill(first, last, seed),  # type: ignore[misc]
        )


def run(numbers: Long, console: Console) -> list[Drill]:
    """All drills, one part after the other; those that were done before by the same code are only read."""
    kept, found = Kept(numbers.keep, hash_of_code()), []
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        todo = list(parts(numbers, Made(scratch / "made", SHIPPED), scratch))
        before = [None if numbers.fresh else kept.get(part) for part in todo]
        left = sum(result is None for result in before)
        console.print(
            f"{len(todo)} parts, {len(todo) - left} of them done before; all of them take about "
            f"{_estimate(numbers) / 60:.0f} min on an idle core. Results are kept in {numbers.keep}.",
            highlight=False,
        )
        for number, (part, earlier) in enumerate(zip(todo, before, strict=True), start=1):
            result = earlier or kept.run(part)
            if earlier is None:
                console.print(
                    f"{number}/{len(todo)} {part.drill} {part.which}: {result.tried} tried, "
                    f"{len(result.failures)} failed, {result.seconds:.0f} s",
                    highlight=False,
                )
            found.append(result)
    return joined(found)


def table(found: list[Drill]) -> Table:
    """What was tried, what came of it, and what failed."""
    result = Table("drill", "tried", "borne", "min", "answers", title="Drills")
    for drill in found:
        answers = ", ".join(f"{count} {answer}" for answer, count in sorted(drill.seen.items()))
        borne = drill.tried - len(drill.failures)
        result.add_row(drill.name, str(drill.tried), str(borne), f"{drill.seconds / 60:.1f}", answers)
    return result


def _estimate(numbers: Long) -> float:
    """Time that all drills take on an idle core, s."""
    flips = numbers.flips * (len(KINDS) + damage.FILES_OF_FOLDERS)
    each = {"kills": numbers.kills, "signals": numbers.signals, "rooms": numbers.rooms, "options": numbers.options}
    return sum(SECONDS[name] * count for name, count in (each | {"flips": flips}).items())


if __name__ == "__main__":
    torch.set_num_threads(1)
    chosen, screen = tyro.cli(Long, prog="make drills"), Console()
    load_content()
    with contextlib.redirect_stdout(io.StringIO()):
        assert main(["list"]) == 0  # loads what forked processes then need not
    results = run(chosen, screen)
    screen.print(table(results))
    for one in results:
        for failure in one.failures:
            screen.print(f"{one.name}: {failure}", style="red", highlight=False, markup=False)
    sys.exit(1 if any(one.failures for one in results) else 0)
