"""Learning curves of a run, read from its event files and drawn against environment steps."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from google.protobuf.message import DecodeError
from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.tensorflow_stub.errors import DataLossError, OutOfRangeError
from tensorboard.compat.tensorflow_stub.pywrap_tensorflow import PyRecordReader_New

from humoslope.errors import UserError
from humoslope.files import write_text
from humoslope.plotting import INK, dress, new_figure, save_figure
from humoslope.seal import beside, check_sums, write_sums
from humoslope.statistics import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STEPS = "Perf/total_steps"
ITERATION = "iteration"
LINE = "#1f6f8b"
CURVE = "curve.csv"
"""Name of the table of curves in a run folder that is kept without its event files."""


@dataclass(frozen=True)
class Panel:
    """A curve: its tag, its title, and the range of its axis if that is known beforehand."""

    tag: str
    title: str
    low: float | None = None
    high: float | None = None


PANELS = (
    Panel("Train/reward", "reward per second"),
    Panel("Train/episode_length", "length of finished episodes, control steps", low=0.0),
    Panel("Train/falls_per_second", "falls per env and second", low=0.0),
    Panel("Curriculum/harness", "scale of the training harness", -0.03, 1.03),
    Panel("Curriculum/terrain_levels", "mean terrain level", low=0.0),
    Panel("Reward/track_velocity", "speed tracking reward per second", low=0.0),
)

KEPT = (*(panel.tag for panel in PANELS), "Train/speed")
"""Curves in a table, beside the steps."""

Curve = dict[int, float]
"""Iteration -> value."""


def read_curves(run_dir: Path) -> dict[str, Curve]:
    """All scalars of a run by tag, iterations in order.

    A run that was resumed wrote several event files. An earlier file is read up to the first iteration of the next one:
    its later iterations were done after the checkpoint that the run was resumed from. A folder without event files may
    have its curves in a table.

    Raises:
        UserError: If the folder does not exist or holds no curves.
    """
    if not run_dir.is_dir():
        raise UserError(f"run folder '{run_dir}' does not exist.")
    parts = [part for path in run_dir.glob("events.out.tfevents.*") if (part := _read(path)) is not None]
    if not parts and (run_dir / CURVE).is_file():
        return read_table(run_dir / CURVE)
    if not parts:
        raise UserError(f"run folder '{run_dir}' holds no curves (events.out.tfevents.*).")
    merged: dict[str, Curve] = {}
    for _, curves in sorted(parts, key=lambda part: part[0]):
        merged = continued(merged, curves)
    return merged


def continued(earlier: Mapping[str, Curve], later: Mapping[str, Curve]) -> dict[str, Curve]:
    """Both sets of curves as one, in which `later` replaces `earlier` from its first iteration on."""
    first = min(min(curve) for curve in later.values())
    merged = {tag: {i: v for i, v in curve.items() if i < first} for tag, curve in earlier.items()}
    for tag, curve in later.items():
        merged.setdefault(tag, {}).update(curve)
    return {tag: dict(sorted(curve.items())) for tag, curve in merged.items() if curve}


def read_table(path: Path) -> dict[str, Curve]:
    """Curves from a table of `write_table`.

    Raises:
        UserError: If the file is not such a table, or was damaged since.
    """
    check_sums(path.parent, "draw it anew from its run, or", beside(path))
    try:
        rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
        tags = [tag for tag in rows[0] if tag != ITERATION]
        return {tag: {int(row[ITERATION]): float(row[tag]) for row in rows if row[tag]} for tag in tags}
    except (OSError, UnicodeError, IndexError, KeyError, ValueError, TypeError):
        raise UserError(f"'{path}' is not a table of curves as `humoslope curve --table` writes it.") from None


def write_table(curves: Mapping[str, Curve], path: Path) -> None:
    """Writes the curves that `draw` and `compare` show as CSV: a line for each iteration, to five digits.

    Event files are large and stay with the run; this table is what is kept of them. Its checksum is put beside it.
    """
    tags = [tag for tag in (STEPS, *KEPT) if tag in curves]
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow([ITERATION, *tags])
    for iteration in curves[STEPS]:
        values = [curves[tag].get(iteration) for tag in tags]
        # Steps are whole, and must not be rounded.
        table.writerow([iteration, *("" if v is None else f"{v:.0f}" if v >= 1e5 else f"{v:.5g}" for v in values)])
    write_text(path, out.getvalue())
    write_sums(path.parent, [path.name], beside(path))


def draw(curves: Mapping[str, Curve], title: str, out: Path) -> None:
    """Writes a figure of the available curves against environment steps.

    Raises:
        UserError: If there are none, or the figure cannot be written.
    """
    panels = [panel for panel in PANELS if panel.tag in curves]
    if STEPS not in curves or not panels:
        raise UserError(f"the curves of {title} hold no {STEPS}, or none of {', '.join(p.tag for p in PANELS)}.")
    columns = min(2, len(panels))
    rows = -(-len(panels) // columns)
    figure = new_figure(5.5 * columns, 0.7 + 2.5 * rows, title)
    axes = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
    for axis in axes[len(panels) :]:
        axis.set_visible(False)
    for axis, panel in zip(axes, panels, strict=False):
        _draw_panel(axis, panel, curves[STEPS], curves[panel.tag])
    figure.supxlabel("environment steps, million", fontsize=10, color=INK)
    save_figure(figure, out)


def smooth(values: Array, window: int) -> Array:
    """Mean over the `window` values around each, fewer at the ends."""
    sums = np.concatenate(([0.0], np.cumsum(values)))
    index = np.arange(len(values))
    low, high = np.maximum(index - window // 2, 0), np.minimum(index + window // 2 + 1, len(values))
    return (sums[high] - sums[low]) / (high - low)


def _draw_panel(axis: Axes, panel: Panel, steps: Curve, curve: Curve) -> None:
    there = [iteration for iteration in curve if iteration in steps]
    x = np.array([steps[i] for i in there]) / 1e6
    y = np.array([curve[i] for i in there])
    axis.plot(x, y, color=LINE, linewidth=0.7, alpha=0.35)
    axis.plot(x, smooth(y, max(1, len(y) // 60)), color=LINE, linewidth=1.8)
    axis.set_title(panel.title, fontsize=10, color=INK, loc="left")
    low, high = axis.get_ylim()
    axis.set_ylim(low if panel.low is None else panel.low, high if panel.high is None else panel.high)
    axis.margins(x=0.01)
    dress(axis)


def _read(path: Path) -> tuple[float, dict[str, Curve]] | None:
    """Start time of an event file and its scalars; None if it has none.

    Its end may be missing, as a killed process leaves it.

    Raises:
        UserError: If one of its records is damaged. What tensorboard itself shows ends there, without a word.
    """
    begun, curves = None, dict[str, Curve]()
    for event in _events(path):
        begun = event.wall_time if begun is None else begun
        for value in event.summary.value:
            if value.HasField("simple_value"):
                curves.setdefault(value.tag, {})[event.step] = value.simple_value
    return (begun, curves) if begun is not None and curves else None


def _events(path: Path) -> Iterator[Event]:
    reader = PyRecordReader_New(str(path))
    while True:
        try:
            reader.GetNext()
            yield Event.FromString(reader.record())
        except OutOfRangeError:
            return
        except DataLossError as error:
            if "truncated" in str(error):
                return
            raise UserError(f"the curves in '{path}' are damaged; without that file the rest can be drawn.") from None
        except DecodeError:
            raise UserError(f"'{path}' holds something else than curves.") from None
