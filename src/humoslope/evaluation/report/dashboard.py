"""A training in the terminal: its progress and its curves, from the event files that it writes."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

from rich.columns import Columns
from rich.console import Group, RenderableType
from rich.panel import Panel as Box
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text
from tensorboard.backend.event_processing.event_accumulator import SCALARS, EventAccumulator

from humoslope.errors import UserError
from humoslope.evaluation.report.chart import chart
from humoslope.evaluation.report.curve import STEPS, Curve, Panel, continued
from humoslope.learning.run_folder import starts

PANELS = (
    Panel("Train/reward", "reward per second"),
    Panel("Train/falls_per_second", "falls per second", low=0.0),
    Panel("Train/speed", "speed, m/s", low=0.0),
    Panel("Curriculum/harness", "harness", 0.0, 1.0),
    Panel("Curriculum/terrain_levels", "terrain level", low=0.0),
    Panel("Train/episode_length", "episode, control steps", low=0.0),
    Panel("Policy/mean_std", "exploration", low=0.0),
    Panel("Loss/value", "value loss", low=0.0),
)
HEIGHT, NARROWEST = 5, 28
"""Lines of a chart, and columns of the narrowest one."""


@dataclass(frozen=True)
class Progress:
    """How far a run has come.

    Attributes:
        task: Its task; "" if the folder does not say.
        iteration, last: Iterations that are done, and in all; 0 if unknown.
        steps: Environment steps.
        rate: Environment steps per second in the last iterations.
        left_s: Time left at this rate, s; None if unknown.
    """

    task: str
    iteration: int
    last: int
    steps: float
    rate: float
    left_s: float | None


class CurveFollower:
    """The curves of a run that is still being written; reads only what is new.

    Raises:
        UserError: If the folder does not exist.
    """

    def __init__(self, run_dir: Path) -> None:
        if not run_dir.is_dir():
            raise UserError(f"run folder '{run_dir}' does not exist.")
        self._run_dir = run_dir
        self._files: dict[Path, EventAccumulator] = {}

    def read(self) -> dict[str, Curve]:
        """All scalars so far, as `read_curves`; empty if there are none."""
        for path in self._run_dir.glob("events.out.tfevents.*"):
            self._files.setdefault(path, EventAccumulator(str(path), size_guidance={SCALARS: 0}))
        merged: dict[str, Curve] = {}
        for events in self._files.values():
            events.Reload()
        there = [events for events in self._files.values() if events.Tags()[SCALARS]]
        for events in sorted(there, key=lambda events: events.FirstEventTimestamp()):
            curves = {tag: {e.step: e.value for e in events.Scalars(tag)} for tag in events.Tags()[SCALARS]}
            merged = continued(merged, curves)
        return merged


def find_newest(logs: Path = Path("logs")) -> Path:
    """The run folder under `logs` whose curves were written last.

    Raises:
        UserError: If there is none.
    """
    events = list(logs.glob("*/*/events.out.tfevents.*")) + list(logs.glob("*/events.out.tfevents.*"))
    if not events:
        raise UserError(f"there is no run with curves under '{logs}'; name its folder, or `humoslope train` one.")
    return max(events, key=lambda path: path.stat().st_mtime).parent


def progress_of(run_dir: Path, curves: Mapping[str, Curve]) -> Progress:
    """How far a run has come, by its curves and the record of its last start."""
    task, last = _configured(run_dir)
    steps = curves[STEPS]
    iteration = max(steps)
    rates = [value for i, value in curves.get("Perf/steps_per_second", {}).items() if i > iteration - 20]
    rate = sum(rates) / len(rates) if rates else 0.0
    # An iteration has as many steps as the last one.
    of_last = steps[iteration] - steps.get(iteration - 1, 0.0) if iteration else steps[iteration]
    ahead = last - iteration - 1
    left = ahead * of_last / rate if last and rate > 0.0 and math.isfinite(rate) else None
    return Progress(task, iteration + 1, last, steps[iteration], rate, left)


def view(run_dir: Path, curves: Mapping[str, Curve], width: int) -> RenderableType:
    """Progress and charts for a terminal of so many columns.

    Raises:
        UserError: If there are no curves.
    """
    if STEPS not in curves:
        raise UserError(f"run folder '{run_dir}' holds no curves yet (events.out.tfevents.*).")
    now = progress_of(run_dir, curves)
    across = max(1, min(4, width // (NARROWEST + 4)))
    inside = max(NARROWEST, width // across - 5)
    boxes = [
        _box(panel, [value for _, value in sorted(curves[panel.tag].items())], inside)
        for panel in PANELS
        if panel.tag in curves
    ]
    return Group(_head(run_dir, now, width), Columns(boxes, padding=(0, 1)))


def _head(run_dir: Path, now: Progress, width: int) -> RenderableType:
    words = [f"{now.steps / 1e6:.2f} M steps", f"{now.rate:,.0f}/s"]
    if now.left_s is not None:
        words.append("complete" if now.iteration >= now.last else f"left {timedelta(seconds=int(now.left_s))}")
    newest = sorted(run_dir.glob("model_*.pt"), key=lambda path: path.stat().st_mtime)
    if newest:
        words.append(f"newest checkpoint {newest[-1].name}")
    grid = Table.grid(padding=(0, 2))
    done = f"{now.iteration}/{now.last}" if now.last else f"{now.iteration} iterations"
    bar = ProgressBar(total=float(now.last or now.iteration), completed=float(now.iteration), width=max(10, width // 4))
    grid.add_row(Text(done, style="bold"), bar, Text("  ".join(words)))
    return Group(Text(f"{now.task or 'run'}  {run_dir}", style="bold", overflow="ellipsis", no_wrap=True), grid)


def _box(panel: Panel, values: list[float], width: int) -> Box:
    lines = chart(values, width, HEIGHT, panel.low, panel.high)
    title = f"{panel.title}: [bold]{values[-1]:.3g}[/bold]"
    finite = [value for value in values if math.isfinite(value)]
    ends = f"{min(finite):.3g} to {max(finite):.3g}" if finite else "not finite"
    return Box(
        Text("\n".join(lines)), title=title, title_align="left", subtitle=ends, subtitle_align="right", width=width + 4
    )


def _configured(run_dir: Path) -> tuple[str, int]:
    """Task and iterations in all of a run, as far as the record of its last start says."""
    records = starts(run_dir)
    try:
        told = json.loads((records[-1] / "config.json").read_text(encoding="utf-8"))
        return str(told["task"]), int(told["agent"]["max_iterations"])
    except (IndexError, OSError, ValueError, KeyError, TypeError):
        return "", 0
