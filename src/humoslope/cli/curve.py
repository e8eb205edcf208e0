"""`humoslope curve RUN`: draws the learning curve of a training run."""

from __future__ import annotations

from pathlib import Path

import tyro

from humoslope.evaluation.report.curve import continued, draw, read_curves, read_table, write_table
from humoslope.plotting import with_ending


def run(arguments: list[str]) -> None:
    """Draws the run named in `arguments`."""
    tyro.cli(curve, args=arguments, prog="humoslope curve")


def curve(run_dir: tyro.conf.Positional[Path], out: Path | None = None, table: Path | None = None) -> None:
    """Draws the learning curve of a run: reward, episode length, falls, harness, terrain level and speed tracking.

    Args:
        run_dir: Path of the run folder; the run may have been resumed any number of times.
        out: Path of the picture; by default curve.png in the run folder.
        table: Path of a CSV file that keeps the drawn curves. If it exists, the run's curves continue those in it, so
            that a run can be continued on a machine without its event files.
    """
    path = with_ending(out or run_dir / "curve.png")
    curves = read_curves(run_dir)
    if table is not None and table.exists():
        curves = continued(read_table(table), curves)
    draw(curves, f"{run_dir.resolve().name}", path)
    print(f"wrote {path}")
    if table is not None:
        write_table(curves, table)
        print(f"wrote {table}")
