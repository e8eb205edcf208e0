"""`humoslope curve RUN`: how a training run went, as a picture."""

from __future__ import annotations

from pathlib import Path

import tyro

from humoslope.evaluation.report.curve import continued, draw, read_curves, read_table, write_table


def run(arguments: list[str]) -> None:
    """Draws the run named in `arguments`."""
    tyro.cli(curve, args=arguments, prog="humoslope curve")


def curve(run_dir: tyro.conf.Positional[Path], out: Path | None = None, table: Path | None = None) -> None:
    """Draws the learning curve of a run: reward, episode length, falls, harness, terrain level and speed tracking.

    Args:
        run_dir: Folder of the run; it may have been resumed any number of times.
        out: Where the picture is written; by default curve.png in the run folder.
        table: A CSV file in which what is drawn is kept. If it is there, the run's curves go on from it, so that a run
            can be continued where its event files are not.
    """
    path = out or run_dir / "curve.png"
    path = path if path.suffix else path.with_suffix(".png")
    curves = read_curves(run_dir)
    if table is not None and table.exists():
        curves = continued(read_table(table), curves)
    draw(curves, f"{run_dir.resolve().name}", path)
    print(f"wrote {path}")
    if table is not None:
        write_table(curves, table)
        print(f"wrote {table}")
