"""`make drills`: the long versions of the drills, as a table; exit code 1 if one failed.

ARGS="--options 100" is shorter. The suite keeps short ones in `test_drills.py`.
"""

from __future__ import annotations

import dataclasses
import sys
import tempfile
import time
from pathlib import Path

import torch
import tyro
from rich.console import Console
from rich.table import Table

from humoslope.cli import main
from humoslope.registry import load_content
from tests.drills import damage, options, processes
from tests.drills.files import make_files
from tests.drills.report import Drill

SHIPPED = Path("experiments/checkpoints/stage1.pt")


@dataclasses.dataclass(frozen=True)
class Long:
    """Numbers of faults.

    Attributes:
        kills: SIGKILLs of one run.
        signals: Runs that are stopped by INT, TERM or HUP.
        rooms: Runs without room for a file.
        options: Values of options.
        flips: Damages of each kind of file, and of each file of an export.
        seed: Seed of all random choices.
    """

    kills: int = 20
    signals: int = 9
    rooms: int = 4
    options: int = 2000
    flips: int = 200
    seed: int = 0


def run(numbers: Long, console: Console) -> list[Drill]:
    """All drills, one after the other."""
    found: list[Drill] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # Processes first: they are forked, which threads of later drills would not survive.
        if numbers.kills:
            found.append(processes.drill_kills(folder, numbers.kills, numbers.seed, last=4 * numbers.kills))
        if numbers.signals:
            found.append(processes.drill_signals(folder, numbers.signals))
        if numbers.rooms:
            found.append(processes.drill_room(folder, numbers.rooms))
        if numbers.flips:
            files, export = make_files(folder / "files", SHIPPED, with_run=True)
            executed = damage.watch_for_execution()
            (folder / "spoilt").mkdir()
            for kind, path in files.items():
                found.append(damage.drill_file(kind, path, folder / "spoilt", numbers.flips, numbers.seed))
            found.append(damage.drill_export(export, folder / "spoilt", numbers.flips, numbers.seed))
            found.append(Drill("anything executed", 1, executed))
        if numbers.options:
            started = time.monotonic()

            def progress(drill: Drill) -> None:
                if drill.tried % 50 == 0:
                    left = (time.monotonic() - started) / drill.tried * (numbers.options - drill.tried)
                    failed = len(drill.failures)
                    console.print(f"{drill.tried}/{numbers.options} options, {failed} failed, left {left / 60:.0f} min")

            found.append(options.drill(numbers.options, numbers.seed, progress=progress))
    return found


def table(found: list[Drill]) -> Table:
    """What was tried, what came of it, and what failed."""
    result = Table("drill", "tried", "borne", "answers", title="Drills")
    for drill in found:
        answers = ", ".join(f"{count} {answer}" for answer, count in sorted(drill.seen.items()))
        result.add_row(drill.name, str(drill.tried), str(drill.tried - len(drill.failures)), answers)
    return result


if __name__ == "__main__":
    torch.set_num_threads(1)
    chosen, screen = tyro.cli(Long, prog="make drills"), Console()
    load_content()
    assert main(["list"]) == 0  # loads what forked processes then need not
    results = run(chosen, screen)
    screen.print(table(results))
    for one in results:
        for failure in one.failures:
            screen.print(f"{one.name}: {failure}", style="red", highlight=False, markup=False)
    sys.exit(1 if any(one.failures for one in results) else 0)
