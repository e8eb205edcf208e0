"""Display of a running evaluation: a table of its cells as they fill, and a progress bar."""

from __future__ import annotations

import math
import time

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Group, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from humoslope.evaluation.track.protocol import HeldOutProtocol
from humoslope.evaluation.track.trials import HeldOutTrials
from humoslope.statistics import mean, proportion


def cell_table(trials: HeldOutTrials, protocol: HeldOutProtocol, title: str) -> Table:
    """Table of every cell with its finished trials."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, collapse_padding=True, pad_edge=False)
    for column in ("grade\n°", "\nµ", "\ntrials", "SR\n%", "95 %\ninterval", "MXD\nm", "T_trav\ns"):
        table.add_column(column, justify="right", no_wrap=True)
    for column in ("\nfell", "\nleft", "timed\nout"):
        table.add_column(column, justify="right", no_wrap=True)
    for g, grade in enumerate(protocol.grades):
        for t, tier in enumerate(protocol.tiers):
            cell = trials[(trials.grade_index == g) & (trials.tier_index == t) & trials.finished]
            table.add_row(
                f"{grade:g}",
                f"{math.tan(math.radians(grade)) + tier:.2f}",
                f"{len(cell)}/{protocol.trials}",
                *_figures(cell),
                end_section=t == len(protocol.tiers) - 1 and t > 0,
            )
    return table


def _figures(cell: HeldOutTrials) -> list[str]:
    if not len(cell):
        return ["-"] * 7
    successes = proportion(int(cell.success.sum()), len(cell))
    seconds = mean(cell.seconds[cell.success])
    return [
        f"{100.0 * successes.share:.1f}",
        f"{100.0 * successes.low:.1f}-{100.0 * successes.high:.1f}",
        f"{np.mean(cell.max_place):.2f}",
        "-" if seconds is None else f"{seconds:.1f}",
        *(str(int(count.sum())) for count in (cell.fell, cell.left, cell.timed_out)),
    ]


class Progress:
    """Share done, speed and time left.

    Args:
        done: Share that was done before.
        step_dt: Control step, s.

    Attributes:
        simulated: Simulated time of all envs, s.
    """

    def __init__(self, done: float, step_dt: float) -> None:
        self._first, self._dt = done, step_dt
        self._started = time.monotonic()
        self.simulated = 0.0

    def step(self, envs: int) -> None:
        """Counts a control step of so many envs."""
        self.simulated += envs * self._dt

    def line(self, done: float) -> RenderableType:
        """Progress bar and text for the share `done`, in [0, 1]."""
        took = time.monotonic() - self._started
        rate = (done - self._first) / took if took > 0.0 else 0.0
        left = _clock((1.0 - done) / rate) if rate > 0.0 else "-"
        words = (
            f"{100.0 * done:.0f} %  {self.simulated / took if took else 0.0:,.0f} simulated s per second, left {left}"
        )
        grid = Table.grid(padding=(0, 2))
        grid.add_row(ProgressBar(total=1.0, completed=done, width=30), Text(words))
        return grid


def view(trials: HeldOutTrials, protocol: HeldOutProtocol, title: str, line: RenderableType) -> Group:
    """Table of the cells above the progress bar."""
    return Group(cell_table(trials, protocol, title), line)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"
