"""`humoslope terrain NAME`: what a terrain looks like."""

from __future__ import annotations

from pathlib import Path

import tyro

from humoslope.registry import load_content
from humoslope.terrain import draw


def terrain(name: str, /, out: Path | None = None, seed: int = 0) -> None:
    """Draws a registered terrain at several grades, from the side and from above, to a PNG.

    Args:
        name: Of the terrain, such as ramp-up.
        out: Where to write; by default NAME.png in the current folder.
        seed: Of the random bumps.
    """
    path = draw.run(name, out if out is not None else Path(f"{name}.png"), seed=seed)
    print(f"wrote {path}")


def run(arguments: list[str]) -> None:
    """Draws the terrain named in `arguments`."""
    load_content()
    tyro.cli(terrain, args=arguments, prog="humoslope terrain")
